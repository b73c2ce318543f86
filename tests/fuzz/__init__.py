"""Inputs that are wrong in every way a seed can think of, and what the commands must not do with them."""
