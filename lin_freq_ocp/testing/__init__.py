"""Random problems, known optima and independent answers, to test a solver with.

======================  ================================================================================================
``reference``           linear problems with known optimal values
``random_convex``       linear dynamics of every kind, bounds and stop bands around a random trajectory
``random_linear``       the same in units of 1e-9 to 1e9, with degenerate dynamics, and bounds that stand for none
``random_lti``          the whole class of the Fourier-domain method, with a trajectory that satisfies the constraints
``random_mixed``        sets, terms and spectra of every kind, each with a CVXPY model written by hand
``random_units``        problems that can be written in any units
``random_infeasible``   problems without a feasible trajectory
``random_kinks``        continuous piecewise-affine dynamics
``oracle``              the optimal cost by plain Clarabel, on a program that shares no code with the package
``checks``              one seed solved by the package and by an oracle, and compared
======================  ================================================================================================

Nothing here is imported by the rest of the package, and nothing here needs pytest.

Examples
--------
>>> from lin_freq_ocp.testing.random_lti import random_lti
>>> random_lti(4).horizon > 0
True
"""
