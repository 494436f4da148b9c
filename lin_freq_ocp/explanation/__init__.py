"""Why a problem has no solution: a smallest family of constraints in conflict, and the least change that helps."""
