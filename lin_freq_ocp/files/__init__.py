"""EXCHANGE: problems and solutions as files (TOML, npz, CSV) and as CVXPY problems."""
