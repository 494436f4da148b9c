"""One sparse convex program, solved by a backend in well-scaled units."""
