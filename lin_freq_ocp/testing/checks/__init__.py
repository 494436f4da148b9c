"""Linear problems against plain Clarabel: ``linear.check(seed)``."""
