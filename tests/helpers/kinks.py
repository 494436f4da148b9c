"""Small piecewise-affine problems of docs/borders.md, whose optima lie on borders and are known by hand."""

import numpy as np

import lin_freq_ocp as lfo


def absolute_value(**changes):
    """x_1 = |x_0| + u_0 from x_0 = 0, cost u_0^2 - x_1: the optimum is u_0 = 1/2."""
    dynamics = _absolute([[1.0]], [[-1.0]])
    given = {"cost": lfo.QuadraticCost(R=2.0, p=[-1.0]), "initial_state": [0.0]} | changes
    return lfo.OptimalControlProblem(dynamics, 1, **given)


def inner_absolute_value():
    """x_1 = u_0, x_2 = |x_1| + u_1, cost 2 u_0 + u_0^2/2 + u_1^2 - x_2, u_0 in [0, 1], u_1 in [-1, 1].

    The cost is u_0 + u_0^2/2 + u_1^2 - u_1: the optimum is u = (0, 1/2).
    """
    right, left = (np.array([[[0.0]], [[slope]]]) for slope in (1.0, -1.0))
    cost = lfo.QuadraticCost(R=[[[1.0]], [[2.0]]], r=[[2.0], [0.0]], p=[-1.0])
    sets = [lfo.Box([0.0], [1.0]), lfo.Box([-1.0], [1.0])]
    return lfo.OptimalControlProblem(_absolute(right, left), 2, cost, sets, None, [1.0])


def max_of_min():
    """x_1 = u_0, x_2 = max(min(x_1, -u_1), u_1 - x_1), u_0 + u_1 = 0, cost -x_1/2 + x_2: the optimum is u = (0, 0).

    With u_0 = v, u_1 = -v, x_2 = max(v, -2 v) and the cost is v/2 for v > 0 and -5 v/2 for v < 0. Where u_1 - x_1 is
    the largest, the region is not convex, and two modes have the same map.
    """
    maps = {"x": (1.0, 0.0), "-u": (0.0, -1.0), "u-x above": (-1.0, 1.0), "u-x below": (-1.0, 1.0)}
    rows = {  # G, H of G x + H u <= 0
        "x": [(1, 1), (-2, 1)],
        "-u": [(-1, -1), (-1, 2)],
        "u-x above": [(-1, -1), (1, -2)],
        "u-x below": [(1, 1), (2, -1)],
    }
    modes = [
        lfo.AffineMode(
            np.array([[[0.0]], [[a]]]),
            np.array([[[1.0]], [[b]]]),
            G=[[row[0]] for row in rows[name]],
            H=[[row[1]] for row in rows[name]],
            h=[0.0, 0.0],
            name=name,
        )
        for name, (a, b) in maps.items()
    ]
    cost = lfo.QuadraticCost(q=[[0.0], [-0.5]], p=[1.0])
    band = lfo.stop_band(bins=[0])
    dynamics = lfo.PiecewiseAffineDynamics(modes)
    return lfo.OptimalControlProblem(dynamics, 2, cost, lfo.Box(-1, 1), None, [3.0], control_spectrum=band)


def peak():
    """x_{t+1} = min(x_t, 2 - x_t) + u_t from 0, cost u_0^2/4 + u_1^2/4 - 2 x_2: the optimum is u = (1, 4), x_1 = 1.

    There eta_1 = 2, eta_0 = 1/2 = 2 alpha - 2 (1 - alpha): alpha = 5/8.
    """
    modes = [
        lfo.AffineMode([[1.0]], [[1.0]], G=[[1.0]], h=[1.0], name="rising"),
        lfo.AffineMode([[-1.0]], [[1.0]], [2.0], G=[[-1.0]], h=[-1.0], name="falling"),
    ]
    return _from_zero(modes)


def valley():
    """x_{t+1} = max(x_t, 2 - x_t) + u_t from 0, and the same cost: u = (-1, 4), x_1 = 1 is the worst place nearby.

    There eta_1 = 2, eta_0 = -1/2 = -2 alpha + 2 (1 - alpha): alpha = 5/8, as if it were an optimum.
    """
    modes = [
        lfo.AffineMode([[-1.0]], [[1.0]], [2.0], G=[[1.0]], h=[1.0], name="falling"),
        lfo.AffineMode([[1.0]], [[1.0]], G=[[-1.0]], h=[-1.0], name="rising"),
    ]
    return _from_zero(modes)


def _from_zero(modes):
    dynamics = lfo.PiecewiseAffineDynamics(modes, state_names=["height [m]"], control_names=["step [m]"])
    return lfo.OptimalControlProblem(
        dynamics, 2, lfo.QuadraticCost(R=0.5, p=[-2.0]), lfo.Box(-5, 5), lfo.Box(-20, 20), [0.0], name="kink"
    )


def elastic_wall(horizon=10, **changes):
    """A mass that meets a spring at x = 1: a convex kink of the force."""
    step = 0.2
    free = lfo.AffineMode([[1, step], [0, 1]], [[0], [step]], G=[[1, 0]], h=[1.0], name="free")
    contact = lfo.AffineMode(
        [[1, step], [-20 * step, 1]], [[0], [step]], [0, 20 * step], G=[[-1, 0]], h=[-1.0], name="contact"
    )
    given = {
        "cost": lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([20.0, 2.0]), x_ref=[1.2, 0.0]),
        "control_set": lfo.Box(-4, 4),
        "state_set": lfo.Box([-1, -3], [2, 3]),
        "initial_state": [0.5, 0.0],
    } | changes
    return lfo.OptimalControlProblem(lfo.PiecewiseAffineDynamics([free, contact]), horizon, **given)


def rotation(horizon=5, initial_state=(1.0, 1.0)):
    """The switched rotation of Bemporad and Morari (Automatica 35, 1999), which jumps at x_1 = 0."""

    def turned(angle):
        c, s = np.cos(angle), np.sin(angle)
        return 0.8 * np.array([[c, -s], [s, c]])

    B = [[0.0], [1.0]]
    modes = [
        lfo.AffineMode(turned(np.pi / 3), B, G=[[-1.0, 0.0]], h=[0.0], name="left turn"),
        lfo.AffineMode(turned(-np.pi / 3), B, G=[[1.0, 0.0]], h=[0.0], name="right turn"),
    ]
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        horizon,
        lfo.QuadraticCost(Q=2.0, R=2.0),
        lfo.Box(-1, 1),
        lfo.Box(-10, 10),
        list(initial_state),
    )


def _absolute(right, left):
    return lfo.PiecewiseAffineDynamics(
        [
            lfo.AffineMode(right, [[1.0]], G=[[-1.0]], h=[0.0], name="right"),
            lfo.AffineMode(left, [[1.0]], G=[[1.0]], h=[0.0], name="left"),
        ]
    )
