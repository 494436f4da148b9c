"""Linear algebra of the Fourier-domain method: bordered KKT systems, working sets and small quadratic programs."""
