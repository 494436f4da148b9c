"""
Formulas with a kink: a tank that overflows
===========================================

A formula with a minimum defines the dynamics of a tank.

The level of the tank starts at 0.2. It rises with the inflow, between 0 and 2, and the
tank leaks; above the level 1 it overflows. Each of four steps costs half the square of
its inflow, a last level of 1 earns 20, and the pump must not alternate. The certificate
checks the maximum principle at the kink, and a global bound is proven.
"""

import numpy as np

import lin_freq_ocp as lfo


def tank(x: np.ndarray, u: np.ndarray) -> list:
    """Fill a tank that overflows at 1 and leaks with the square root of its level."""
    return [
        lfo.minimum(
            x[0] + 0.2 * u[0] - 0.1 * np.sqrt(x[0] + 0.01),
            1.0,
            names=("filling", "full"),
        )
    ]


problem = lfo.OptimalControlProblem(
    dynamics=lfo.PiecewiseSmoothDynamics.from_formulas(
        tank, 1, 1, state_names=["level"], control_names=["inflow"]
    ),
    horizon=4,
    cost=lfo.QuadraticCost(R=1.0, p=[-20.0]),
    control_set=lfo.Box(0, 2),  # of the inflow: change this number
    state_set=lfo.Box(0, 1),
    initial_state=[0.2],
    control_spectrum=lfo.stop_band(bins=[2]),  # the pump must not alternate
)
result = lfo.solve(problem, tolerance=1e-3)
certificate = result.certificate
print(
    "inflow",
    np.round(result.control[:, 0], 4),
    "level",
    np.round(result.trajectory.x[:, 0], 4),
)
print("modes ", " ".join(problem.mode_names[i] for i in result.sequence))
print(f"maximum principle {certificate.pmp}; {certificate.borders}")
print(f"cost {result.cost:.6f}, no trajectory below {result.lower_bound}")
figure = result.plot()
figure.savefig("kinks.png")
print("picture: kinks.png")
