"""Results as plain data for JSON: the keys are a contract; what is absent is null, never 0 or infinity."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lin_freq_ocp.analysis.measures import Measures
from lin_freq_ocp.atomic import write_text
from lin_freq_ocp.certificate.directions import Direction
from lin_freq_ocp.certificate.modes.clarke import SwitchingFacts
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.outcome import Outcome

if TYPE_CHECKING:
    from lin_freq_ocp.comparison.compare import ComparisonOutcome

SCHEMA = 1


def result_summary(result: Outcome, with_trajectory: bool = False) -> dict[str, Any]:
    """Return a result as the JSON object of ``lin-freq-ocp solve --json``, with ``--trajectory`` if asked for."""
    conflict = None
    if result.conflict is not None:
        conflict = [{"block": one.block, "share": one.share, "times": list(one.times)} for one in result.conflict]
    return finite(
        {
            **head(result.problem),
            "status": result.status,
            "primal": result.primal,
            "dual": result.dual,
            **_values(result.certificate),
            "method": result.method,
            "backend": result.backend,
            "seconds": result.seconds,
            "certificate": _certificate(result.certificate),
            "conflict": conflict,
            "explanation": None if result.explanation is None else asdict(result.explanation),
            "direction": _direction(result.direction),
            "modes": None if result.sequence is None else [int(mode) for mode in result.sequence],
            "tree": _tree(result),
            "message": result.message or None,
            **({"trajectory": _trajectory(result)} if with_trajectory else {}),
        }
    )


def certificate_summary(problem: OptimalControlProblem, certificate: Certificate) -> dict[str, Any]:
    """Return a certificate as the JSON object of ``lin-freq-ocp certify --json``."""
    return finite({**head(problem), **_values(certificate), "certificate": _certificate(certificate)})


def comparison_summary(comparison: ComparisonOutcome) -> dict[str, Any]:
    """Return the JSON object of ``lin-freq-ocp compare --json``: the constrained result, and all beside it."""
    filtered = {
        one.name: {
            **asdict(one.replay.measures),
            "description": one.description,
            "replay_meaningful": one.replay.meaningful,
            "one_step_residual": one.replay.one_step_residual.tolist(),
        }
        for one in comparison.filtered
    }
    base: dict[str, Any] = result_summary(comparison.constrained)
    return finite(
        {
            **base,
            "classical": _measures(comparison.classical_measures),
            "constrained": _measures(comparison.constrained_measures),
            "filtered": filtered,
        }
    )


def failed_comparison_summary(result: Outcome) -> dict[str, Any]:
    """Return the same object for a problem that has no solution even without its frequency constraints."""
    return {**result_summary(result), "classical": None, "constrained": None, "filtered": {}}


def to_json(summary: Mapping[str, Any]) -> str:
    """Return a summary as JSON text; what JSON cannot say is null already."""
    return json.dumps(summary, indent=2, allow_nan=False)


def save_json(path: str | Path, summary: Mapping[str, Any]) -> None:
    """Write a summary as a JSON file."""
    write_text(path, to_json(summary) + "\n")


def head(problem: OptimalControlProblem) -> dict[str, Any]:
    """Return what every JSON object begins with."""
    return {
        "schema": SCHEMA,
        "version": version("lin-freq-ocp"),
        "problem": {
            "name": problem.name,
            "horizon": problem.horizon,
            "state_dim": problem.state_dim,
            "control_dim": problem.control_dim,
            "sampling_time": problem.sampling_time,
        },
    }


def _values(certificate: Certificate | None) -> dict[str, Any]:
    if certificate is None:
        return {"cost": None, "lower_bound": None, "gap": None, "bound": None}
    proven = certificate.bound is not None and certificate.lower_bound is not None
    return {
        "cost": certificate.cost,
        "lower_bound": certificate.lower_bound,
        "gap": certificate.gap,
        "bound": certificate.bound.kind if proven and certificate.bound is not None else None,
    }


def _certificate(certificate: Certificate | None) -> dict[str, Any] | None:
    if certificate is None:
        return None
    return {
        "pmp": certificate.pmp,
        "normal": certificate.normal,
        "global": certificate.globally_optimal,
        "conditions": [{**asdict(one), "passed": one.passed} for one in certificate.conditions],
        "descent": _direction(certificate.descent),
        "borders": _borders(certificate.borders),
    }


def _borders(facts: SwitchingFacts | None) -> dict[str, Any] | None:
    if facts is None:
        return None
    jumping = facts.jumping
    return {
        "joint": facts.joint,
        "flip_stationary": facts.flip_stationary,
        "printed": facts.printed,
        "regular": facts.regular,
        "elsewhere": facts.elsewhere,
        "modes": list(facts.mode_names),
        "times": list(facts.times),
        "weights": facts.weights.tolist(),
        "flips": [flip._asdict() for flip in facts.flips],
        "jumping": jumping and {"modes": [jumping.first, jumping.second], "jump": jumping.jump, "time": jumping.time},
        "conditions": [{**asdict(one), "passed": one.passed} for one in facts.conditions],
        "norms": [kink._asdict() for kink in facts.norms],
    }


def _direction(direction: Direction | None) -> dict[str, Any] | None:
    if direction is None:
        return None
    return {"slope": direction.slope, "residual": direction.residual, "time": direction.steepest}


def _trajectory(result: Outcome) -> dict[str, Any] | None:
    """Return times, states and controls, one row per time; the times in seconds if there is a sampling time."""
    if result.trajectory is None:
        return None
    problem = result.problem
    step = problem.sampling_time
    return {
        "time": None if step is None else [t * step for t in range(problem.horizon + 1)],
        "state_names": list(problem.state_names),
        "control_names": list(problem.control_names),
        "x": result.trajectory.x.tolist(),
        "u": result.trajectory.u.tolist(),
    }


def _tree(result: Outcome) -> dict[str, Any] | None:
    if result.tree is None or result.tree_bound is None:
        return None
    proof = result.tree_bound
    return {"nodes": len(result.tree.nodes), "leaves": proof.leaves, "covers": proof.covers}


def _measures(measures: Measures | None) -> dict[str, Any] | None:
    return None if measures is None else asdict(measures)


def finite(value: Any) -> Any:
    """Replace what JSON cannot say, NaN and infinity, by null."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
