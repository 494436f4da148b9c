"""The optimum of a problem as a differentiable function of its data, for PyTorch and JAX."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import NoDerivativeError, ProblemError, missing_extra
from lin_freq_ocp.derivatives.data import data_for, data_of, with_data
from lin_freq_ocp.derivatives.derivatives import WEAK, Existence, SolutionDerivatives
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem

Foreign = Any  # tensors and modules of the other package, which may be absent
Solutions = list[SolutionDerivatives]
OF_EACH = ("initial_state", "terminal_state", "x_ref", "u_ref")  # data that may have a leading axis, for a batch
MOST_KEPT = 8  # solutions that a layer keeps, for the way back


@dataclass(eq=False)
class Layer:
    """A problem as a function of some of its data, with the derivatives of the last solutions."""

    problem: OptimalControlProblem
    names: tuple[str, ...]
    kinks: str
    _kept: dict[tuple[bytes, ...], Solutions] = field(default_factory=dict[tuple[bytes, ...], Solutions])

    def __post_init__(self) -> None:
        require_problem(self.problem)
        if self.kinks not in ("error", "right"):
            raise ProblemError("kinks", repr(self.kinks), "'error' or 'right'")
        data_for(self.problem, {name: self._values.get(name, 0.0) for name in self.names if name not in OF_EACH})

    def batch(self, data: Sequence[Array]) -> int | None:
        """Return the number of problems that data of initial states and references are for; None for one."""
        sizes = {len(d) for name, d in zip(self.names, data, strict=True) if self._has_batch(name, d)}
        if len(sizes) > 1:
            raise ProblemError("layer", f"batches of {sorted(sizes)}", "one size of the leading axis")
        return sizes.pop() if sizes else None

    def _has_batch(self, name: str, value: Array) -> bool:
        return name in OF_EACH and value.ndim == 1 + self._values[name].ndim

    @cached_property
    def _values(self) -> dict[str, Array]:
        return data_of(self.problem)

    def _of_each(self, data: Sequence[Array]) -> list[dict[str, Array]]:
        """Return the data, or changes of them, of each problem of a batch."""
        batched = [(name, d, self._has_batch(name, d)) for name, d in zip(self.names, data, strict=True)]
        return [{name: d[i] if many else d for name, d, many in batched} for i in range(self.batch(data) or 1)]

    def solutions(self, data: Sequence[Array]) -> Solutions:
        """Return the derivatives of each problem of a batch, or of the only one."""
        key = tuple(d.tobytes() for d in data)
        if key not in self._kept:
            each = [with_data(self.problem, data_for(self.problem, one)) for one in self._of_each(data)]
            self._kept[key] = [solve(problem).derivatives for problem in each]
            while len(self._kept) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
        return self._kept[key]

    def outputs(self, data: Sequence[Array]) -> tuple[Array, Array, Array]:
        """Return x, u and the cost; of a batch, with a leading axis."""
        points = [(one.trajectory, one.problem) for one in self.solutions(data)]
        parts = [(at.x, at.u, np.asarray(problem.value(at.x, at.u))) for at, problem in points]
        x, u, cost = (np.stack(part) if self.batch(data) is not None else part[0] for part in zip(*parts, strict=True))
        return x, u, cost

    def gradients(self, data: Sequence[Array], bars: Sequence[Array]) -> tuple[Array, ...]:
        """Return the derivatives of <bars, outputs> by the data, in their shapes; NoDerivativeError where none is."""
        parts, each = list[dict[str, Array]](), [bars] if self.batch(data) is None else zip(*bars, strict=True)
        for one, (x, u, cost) in zip(self.solutions(data), each, strict=True):
            gradient, prices = one.vjp(x=x, u=u), one.prices
            self._require(gradient)
            parts.append({name: gradient[name] + float(cost) * prices[name] for name in self.names})
        return self._in_shapes(data, parts)

    def cost_curvatures(self, data: Sequence[Array], weights: Array, bars: Sequence[Array]) -> tuple[Array, ...]:
        """Return the derivatives of <bars, slopes of the weighted cost> by the weights, then by the data."""
        of_weights, parts = list[float](), list[dict[str, Array]]()
        for one, weight, change in zip(self.solutions(data), np.ravel(weights), self._of_each(bars), strict=True):
            step = one.jvp(**change)
            self._require(step)
            found = one.prices_along(step, **change)
            of_weights.append(step.cost)
            parts.append({name: float(weight) * found[name] for name in self.names})
        return np.reshape(of_weights, np.shape(weights)), *self._in_shapes(data, parts)

    def _require(self, found: Existence) -> None:
        if not found.exists and not (self.kinks == "right" and found.reason.startswith(WEAK)):
            raise NoDerivativeError(f"layer: no derivative: {found.reason}.", found.rows)

    def _in_shapes(self, data: Sequence[Array], parts: Sequence[dict[str, Array]]) -> tuple[Array, ...]:
        """Return derivatives in the shapes of the data, summed over problems and times that share a datum."""
        found = list[Array]()
        for name, given in zip(self.names, data, strict=True):
            has_batch, each = self._has_batch(name, given), np.nan_to_num([part[name] for part in parts])
            shared = range(has_batch, each.ndim - given.ndim + has_batch)
            found.append(each.sum(axis=tuple(shared)))
        return tuple(found)


def to_torch(problem: OptimalControlProblem, data: Sequence[str], kinks: str = "error") -> Callable[..., Foreign]:
    """Return the optimum as a differentiable function of some data: x, u, cost = layer(*tensors).

    Parameters
    ----------
    problem : OptimalControlProblem
    data : sequence of str
        The names of the data that the tensors state, in this order, those of a ``Gradient``. Initial states, terminal
        states and references may have a leading axis, for a batch, which the answers then have, too.
    kinks : {"error", "right"}
        Where rows are active with multiplier zero and the loss sees them: an error, or the derivative with these rows
        free, an element of the B-subdifferential.

    Returns
    -------
    callable
        Its backward pass raises NoDerivativeError where there is no derivative. The cost also has second derivatives.

    Raises
    ------
    MissingExtraError
        If PyTorch is not installed.
    ProblemError
        If a datum is unknown.

    References
    ----------
    docs/derivatives.md

    Examples
    --------
    >>> from importlib.util import find_spec
    >>> problem = lfo.library.double_integrator()
    >>> find_spec("torch") is None or callable(lfo.to_torch(problem, ["initial_state"]))
    True
    """
    torch, layer = _require("torch"), Layer(problem, tuple(data), kinks)

    def arrays(tensors: Sequence[Foreign]) -> list[Array]:
        return [tensor.detach().cpu().numpy() for tensor in tensors]

    def like(found: Sequence[Array], tensors: Sequence[Foreign]) -> tuple[Foreign, ...]:
        return tuple(torch.tensor(np.array(one)).to(tensor) for one, tensor in zip(found, tensors, strict=True))

    @torch.autograd.function.once_differentiable
    def of_signals(_: Foreign, bars: Sequence[Array], *tensors: Foreign) -> tuple[Foreign, ...]:
        return like(layer.gradients(arrays(tensors), bars), tensors)

    class CostSlopes(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Foreign, weights: Foreign, *tensors: Foreign) -> tuple[Foreign, ...]:
            ctx.save_for_backward(weights, *tensors)
            data, (weight,), signals = arrays(tensors), arrays([weights]), layer.outputs(arrays(tensors))[:2]
            return like(layer.gradients(data, [*map(np.zeros_like, signals), weight]), tensors)

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx: Foreign, *bars: Foreign) -> tuple[Foreign, ...]:
            weight, *data = arrays(ctx.saved_tensors)
            return like(layer.cost_curvatures(data, weight, arrays(bars)), ctx.saved_tensors)

    class Optimum(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Foreign, *tensors: Foreign) -> tuple[Foreign, ...]:
            ctx.save_for_backward(*tensors)
            ctx.set_materialize_grads(False)
            return tuple(torch.tensor(np.array(part)) for part in layer.outputs(arrays(tensors)))

        @staticmethod
        def backward(ctx: Foreign, *bars: Foreign) -> tuple[Foreign, ...]:
            tensors = ctx.saved_tensors
            if bars[0] is None and bars[1] is None:  # the cost alone has second derivatives
                return (None,) * len(tensors) if bars[2] is None else CostSlopes.apply(bars[2], *tensors)
            outputs = zip(layer.outputs(arrays(tensors)), bars, strict=True)
            weights = [np.zeros_like(at) if bar is None else arrays([bar])[0] for at, bar in outputs]
            return of_signals(ctx, weights, *tensors)

    return Optimum.apply


def to_jax(problem: OptimalControlProblem, data: Sequence[str], kinks: str = "error") -> Callable[..., Foreign]:
    """Return the optimum as a differentiable function of some data for JAX; it works under jit, grad and vmap.

    Parameters
    ----------
    problem, data, kinks
        As for ``to_torch``. ``vmap`` makes batches.

    Returns
    -------
    callable
        x, u, cost = layer(*arrays). Errors of a solve come out of JAX as its own errors, with their text.

    Raises
    ------
    MissingExtraError
        If JAX is not installed.
    ProblemError
        If a datum is unknown.

    References
    ----------
    docs/derivatives.md

    Examples
    --------
    >>> from importlib.util import find_spec
    >>> problem = lfo.library.double_integrator()
    >>> find_spec("jax") is None or callable(lfo.to_jax(problem, ["initial_state"]))
    True
    """
    jax, layer = _require("jax"), Layer(problem, tuple(data), kinks)
    real = jax.numpy.result_type(float)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim

    def call_back(
        function: Callable[..., tuple[Array, ...]], shapes: Sequence[Foreign], *arguments: Foreign
    ) -> Foreign:
        def on_arrays(*given: Foreign) -> tuple[Array, ...]:
            parts = function(*jax.tree_util.tree_map(np.asarray, given))
            return tuple(np.asarray(part, shape.dtype) for part, shape in zip(parts, shapes, strict=True))

        return jax.pure_callback(on_arrays, tuple(shapes), *arguments, vmap_method="sequential")

    @jax.custom_vjp
    def optimum(*arrays: Foreign) -> Foreign:
        batch = layer.batch(arrays)
        axes = () if batch is None else (batch,)
        shapes = [jax.ShapeDtypeStruct((*axes, *shape), real) for shape in ((T + 1, n), (T, m), ())]
        return call_back(lambda *given: layer.outputs(given), shapes, *arrays)

    def back(arrays: Foreign, bars: Foreign) -> Foreign:
        shapes = [jax.ShapeDtypeStruct(array.shape, array.dtype) for array in arrays]  # JAX takes conjugates
        return call_back(lambda one, two: tuple(np.conj(g) for g in layer.gradients(one, two)), shapes, arrays, bars)

    optimum.defvjp(lambda *arrays: (optimum(*arrays), arrays), back)
    return optimum


def _require(package: str) -> Foreign:
    try:
        return import_module(package)
    except ImportError:
        raise missing_extra(f"to_{package}", package, package) from None
