"""
Gusts: a move that stays in front of the wall whatever the wind does
====================================================================

A cart stops 4 cm in front of a wall. Every gust of up to 50 mN keeps it off the wall.

The cart of 1 kg has a force of at most 1 N and moves by 1 m in 4 s. A gust may push it
with up to 50 mN, anew at every step. ``lfo.robust`` lowers all limits by what gusts can
do while the cart is fed back, and ``lfo.worst_case`` returns the worst gusts for each
limit. The plan without margins hits the wall.
"""

import numpy as np

import lin_freq_ocp as lfo

gust = 0.05  # N: change this number
step, horizon = 0.1, 40
cart = lfo.LinearDynamics(
    [[1, step], [0, 1]],
    [[step**2 / 2], [step]],
    sampling_time=step,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["force [N]"],
)
problem = lfo.OptimalControlProblem(
    cart,
    horizon,
    cost=lfo.QuadraticCost(
        Q=np.diag([5, 0.1]), R=0.1, P=np.diag([50, 5]), x_ref=[1, 0]
    ),
    control_set=lfo.Box(-1, 1),
    state_set=lfo.Box({"position": (None, 1.04), "speed": (-0.6, 0.6)}),
    initial_state=[0, 0],
    name="cart in the wind",
)
wind = lfo.Disturbance(lfo.Box(-gust, gust), input=cart.B)
answers = {
    "without margins": lfo.solve(problem),
    "for all gusts": lfo.solve(lfo.robust(problem, wind)),
}

rng = np.random.default_rng(0)
K = wind.feedback(problem)
for name, answer in answers.items():
    plan, reached = answer.trajectory, -np.inf
    for _ in range(500):
        push, x = gust * rng.choice([-1, 1]), plan.x[0]
        for t in range(horizon):
            push = -push if rng.random() < 0.03 else push  # the wind turns
            u = plan.u[t] + K @ (x - plan.x[t])
            x = cart.A @ x + cart.B @ (u + push)
            reached = max(reached, x[0])
    worst = lfo.worst_case(problem, wind, answer)["position, upper"]
    centimetres = [100 * value for value in (reached, worst.attained, worst.limit)]
    found, most, limit = (f"{value:.1f}" for value in centimetres)
    print(f"{name:16}500 winds reach {found} cm, the worst gusts {most} cm of {limit}")
print(lfo.worst_case(problem, wind, answers["for all gusts"]).verdict)
figure = answers["for all gusts"].plot()
figure.savefig("gusts.png")
print("picture: gusts.png")
