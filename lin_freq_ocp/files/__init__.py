"""Problems, results and runs as files, and as objects of CVXPY and python-control."""
