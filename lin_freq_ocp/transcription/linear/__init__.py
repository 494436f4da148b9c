"""Linear problems as sparse convex programs, and their duals as multipliers."""
