"""Second opinions on the laws: plain NumPy, written for all pairs or joints at once, as slow as it likes.

Nothing here imports a law. Tolerances are said again, so that a changed one is noticed.
"""
