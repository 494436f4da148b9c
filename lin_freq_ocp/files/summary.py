"""Results as plain data for JSON: the keys are a contract; an absent value is null, never 0 or infinity."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from lin_freq_ocp.base.atomic import write_text
from lin_freq_ocp.certificate.conditions import Condition
from lin_freq_ocp.certificate.rays import Direction
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.files.reading import FileTable, FileValue
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.outcome import Outcome

if TYPE_CHECKING:
    from lin_freq_ocp.certificate.hybrid.clarke import SwitchingFacts
    from lin_freq_ocp.comparison.compare import ComparisonOutcome
    from lin_freq_ocp.solving.hybrid.modes import TreeEvidence
    from lin_freq_ocp.uncertainty.worst_loads import WorstCase

SCHEMA = 2


def result_summary(result: Outcome, with_trajectory: bool = False, worst: WorstCase | None = None) -> FileTable:
    """Return a result as the JSON object of ``lin-freq-ocp solve --json``, with ``--trajectory`` if asked for."""
    use, multipliers, tree = result.level_use, result.multipliers, None
    search = cast("TreeEvidence | None", result.evidence)  # isinstance would load the methods for modes
    if search is not None:
        tree = {"nodes": len(search.tree.nodes), "leaves": search.bound.leaves, "covers": search.bound.covers}
    extras: FileTable = {}
    if multipliers is not None and multipliers.frequencies:
        # Of each mask at every frequency: the frequencies of its multipliers, with their real and imaginary parts
        extras["atoms"] = {
            name: np.column_stack([frequencies, multipliers.stage[name]]).tolist()
            for name, frequencies in multipliers.frequencies.items()
        }
    if use is not None:  # how the control uses its levels: duty cycles by component, time and level
        duty_cycles = [component.tolist() for component in use.duty_cycles]
        extras["levels"] = {"fractional": use.fractional, "rows": use.rows, "duty_cycles": duty_cycles}
    if result.between_samples is not None:
        extras["between_samples"] = [asdict(bound) for bound in result.between_samples.bounds]
    if worst is not None:
        extras["worst_case"] = _worst_case(worst)
    if result.readings:
        extras["spectra"] = [asdict(reading) for reading in result.readings]
    return finite(
        {
            **head(result.problem),
            "status": result.status,
            "primal": result.primal,
            "dual": result.dual,
            **_values(result, result.bound),
            "method": result.method,
            "backend": result.backend,
            "seconds": result.seconds,
            "certificate": _certificate(result.certificate),
            "conflict": None if result.conflict is None else [asdict(part) for part in result.conflict],
            "explanation": None if result.explanation is None else asdict(result.explanation),
            "direction": _direction(result.direction),
            "modes": None if result.sequence is None else result.sequence.tolist(),
            "tree": tree,
            "message": result.message or None,
            "remarks": result.remarks,
            "attempts": [asdict(attempt) | {"reason": str(attempt.reason)} for attempt in result.attempts],
            **extras,
            **({"trajectory": _trajectory(result)} if with_trajectory else {}),
        }
    )


def certificate_summary(problem: OptimalControlProblem, certificate: Certificate) -> FileTable:
    """Return a certificate as the JSON object of ``lin-freq-ocp certify --json``."""
    bound = None if certificate.bound is None or certificate.lower_bound is None else certificate.bound.kind
    extras: FileTable = {}
    if certificate.between_samples is not None:
        extras["between_samples"] = [asdict(bound) for bound in certificate.between_samples.bounds]
    return finite({**head(problem), **_values(certificate, bound), "certificate": _certificate(certificate), **extras})


def worst_case_summary(problem: OptimalControlProblem, worst: WorstCase) -> FileTable:
    """Return a worst case as the JSON object of ``lin-freq-ocp worst-case --json``."""
    judged = dict.fromkeys(("lower_bound", "gap", "bound", "certificate"))  # certify finds these
    return finite({**head(problem), "cost": worst.cost, **judged, "worst_case": _worst_case(worst)})


def _worst_case(worst: WorstCase) -> FileTable:
    """Return a worst case by the names of its attributes."""
    parts = {"limits": worst.limits, "leakage": worst.leakage, "soft": worst.soft}
    tables = {part: [asdict(one) | {"holds": one.holds} for one in given] for part, given in parts.items()}
    return {"holds": worst.holds, "verdict": worst.verdict, **asdict(worst), **tables}


def comparison_summary(comparison: ComparisonOutcome) -> FileTable:
    """Return the JSON object of ``lin-freq-ocp compare --json``: the constrained result and all others."""
    constrained, moves = comparison.constrained_measures, {}
    if comparison.moves is not None:
        moves["moves"] = {
            move.name: {
                "description": move.description,
                "found": move.measured is not None,
                "samples": move.samples,
                "seconds": move.seconds,
                "vibration": move.ratio,
            }
            for move in comparison.moves.all
        }
    return finite(
        {
            **result_summary(comparison.constrained),
            "classical": asdict(comparison.classical_measures),
            "constrained": None if constrained is None else asdict(constrained),
            "filtered": {
                filtered.name: {
                    **asdict(filtered.replay.measures),
                    "description": filtered.description,
                    "replay_meaningful": filtered.replay.meaningful,
                    "one_step_residual": filtered.replay.one_step_residual.tolist(),
                }
                for filtered in comparison.filtered
            },
            **moves,
        }
    )


def failed_comparison_summary(result: Outcome) -> FileTable:
    """Return the same object for a problem that is infeasible even without its frequency constraints."""
    return {**result_summary(result), "classical": None, "constrained": None, "filtered": {}}


def to_json(summary: Mapping[str, object]) -> str:
    """Return a summary as JSON text; it holds finite numbers only."""
    return json.dumps(summary, indent=2, allow_nan=False)


def save_json(path: str | Path, summary: Mapping[str, object]) -> None:
    """Write a summary as a JSON file."""
    write_text(path, to_json(summary) + "\n")


def head(problem: OptimalControlProblem) -> FileTable:
    """Return the first entries of every JSON object."""
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


def _values(source: Outcome | Certificate, bound: str | None) -> FileTable:
    return {"cost": source.cost, "lower_bound": source.lower_bound, "gap": source.gap, "bound": bound}


def _certificate(certificate: Certificate | None) -> FileTable | None:
    if certificate is None:
        return None
    return {
        "pmp": certificate.pmp,
        "normal": certificate.normal,
        "global": certificate.globally_optimal,
        "conditions": _conditions(certificate.conditions),
        "descent": _direction(certificate.descent),
        "borders": _switching_facts(cast("SwitchingFacts | None", certificate.borders)),
    }


def _conditions(conditions: Sequence[Condition]) -> list[FileTable]:
    tables = list[FileTable]()
    for condition in conditions:
        table = asdict(condition)
        del table["rounding"]  # of the judge alone
        if condition.peak is None:
            del table["peak"]
        else:
            del table["peak"]["hertz"]  # the unit of a text; tables are in rad/sample
        tables.append(table | {"passed": condition.passed})
    return tables


def _switching_facts(facts: SwitchingFacts | None) -> FileTable | None:
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
        "conditions": _conditions(facts.conditions),
        "norms": [kink._asdict() for kink in facts.norms],
        "gaps": list(facts.gaps),
    }


def _direction(direction: Direction | None) -> FileTable | None:
    if direction is None:
        return None
    return {"slope": direction.slope, "residual": direction.residual, "time": direction.steepest[0]}


def _trajectory(result: Outcome) -> FileTable | None:
    """Return times, states and controls, one row per time; the times in seconds if there is a sampling time."""
    if result.trajectory is None:
        return None
    problem = result.problem
    return {
        "time": None if problem.sampling_time is None else problem.times.tolist(),
        "state_names": list(problem.state_names),
        "control_names": list(problem.control_names),
        "x": result.trajectory.x.tolist(),
        "u": result.trajectory.u.tolist(),
    }


def finite(value: FileValue) -> FileValue:
    """Replace NaN and infinity, which JSON does not have, by null, and a response by the keys of problem files."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return finite({"G_real": value.real, "G_imag": value.imag} if np.iscomplexobj(value) else value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
