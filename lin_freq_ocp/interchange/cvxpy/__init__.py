"""Problems as CVXPY problems."""
