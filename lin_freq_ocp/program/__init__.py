"""TRANSCRIBE: a problem becomes a convex program with named rows, and its duals become the theorem's multipliers."""
