"""A MuJoCo workcell in which tele-operated and autonomous arms share one space without colliding."""
