"""The linear program of a problem: rows and their sparse form, units, and the solvers that take it."""
