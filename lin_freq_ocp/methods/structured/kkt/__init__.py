"""One step's linear system: recursions over time, and a dense or iterative system for the rows that couple times."""
