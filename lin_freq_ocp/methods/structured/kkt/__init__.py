"""The linear system of a step: recursions over time, and a dense or iterative system for the rows that couple times."""
