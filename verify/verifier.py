"""The front door: one specification, one policy, a verdict.

The only module that knows all three islands: the engine, the falsifier and the checker.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..models.binding import bind
from ..models.closed_loop import ClosedLoop, Plant
from ..models.onnx_reader import read_policy
from ..models.policy import Policy
from ..specs.errors import InputError, SetrlError, UsageError
from ..specs.reader import find_specification, read_specification
from ..specs.specification import Specification
from . import rounding
from .certificate import certificate_of, cover_of
from .certified import certified
from .closed_loop import Engine
from .contradiction import require_no_contradiction
from .deadline import Deadline
from .evidence_files import EvidenceFiles, evidence_files
from .falsifier import Candidate, propose, propose_all
from .model import initial_box, observation_radius, prepare
from .options import Options
from .reason import explain
from .result import Flowpipe, ProvedWitness, RequirementResult, Result, Value, Verdict
from .runtime_error import runtime_error, runtime_name, runtime_note
from .separation import containment_margins, facet_separation, prepare_polytope
from .splitting import FAILED, PROVED, Exploration, InitialSet, explore
from .watch import PARTS
from .witnessed import proved_witness
from .wording import claim_sentence

Array = NDArray[np.float64]
Radius = Any
Progress = Callable[[Exploration], None]
Part: TypeAlias = tuple[tuple[Fraction, Fraction], ...]
"""A box in state space, exact."""

ILL_CONDITIONED = 0.01
"""Networks whose e_L exceeds this share of the action range are refused for the deployed semantics."""


@dataclass(frozen=True)
class _Job:
    """One closed loop at several perturbation radii."""

    loops: tuple[ClosedLoop, ...]
    options: Options


def load(
    policy: Policy | str | os.PathLike[str], specification: Specification | str | os.PathLike[str]
) -> tuple[Policy, Specification]:
    """Read a policy and a specification, each given as an object, a path or (specifications) a shipped name."""
    if not isinstance(policy, Policy):
        policy = read_policy(os.fspath(policy))
    if not isinstance(specification, Specification):
        specification = read_specification(find_specification(specification))
    return policy, specification


def verify(
    policy: Policy | str | os.PathLike[str],
    specification: Specification | str | os.PathLike[str],
    *,
    options: Options | None = None,
    epsilon: Radius = None,
    plant: Plant | None = None,
    progress: Progress | None = None,
    deadline: Deadline | None = None,
    check: bool = True,
    workers: int | None = None,
) -> Result:
    """Decide whether a policy keeps a plant within a specification.

    Parameters
    ----------
    policy : Policy or path
        An ONNX file.
    specification : Specification, path or shipped name
    options : Options, optional
    epsilon : number or mapping, optional
        Radius of the observation perturbation instead of the specification's.
    plant : Plant, optional
        Instead of the plant that the specification names.
    progress : callable, optional
        Called with the state of the search after every batch. Its method ``checking(checked, leaves)``, where it has
        one, is called after every leaf that was checked.
    deadline : Deadline, optional
        Instead of one made from ``options.timeout``; lets the caller interrupt.
    check : bool
        Whether the checker has to accept the certificate; without it a proof is only CLAIMED.
    workers : int, optional
        Processes that check leaves side by side; as many as there are processors, where that is worth it.

    Returns
    -------
    Result
        "Could not prove" is a result with a reason, never an exception.

    Raises
    ------
    SetrlError
        Wrong input.
    """
    return verify_radii(
        policy,
        specification,
        [epsilon],
        options=options,
        plant=plant,
        progress=progress,
        deadline=deadline,
        check=check,
        workers=workers,
    )[0]


def verify_radii(
    policy: Policy | str | os.PathLike[str],
    specification: Specification | str | os.PathLike[str],
    radii: Sequence[Radius],
    *,
    options: Options | None = None,
    plant: Plant | None = None,
    progress: Progress | None = None,
    deadline: Deadline | None = None,
    check: bool = True,
    workers: int | None = None,
    part: Part | None = None,
) -> list[Result]:
    """`verify` for several observation radii in one array program; one result per radius, in order.

    A radius of None is the specification's own. A `part` is a box within the initial set: only what starts there is
    decided, and a proof is only CLAIMED, because a certificate covers the whole set (`parts.joined` makes it one).
    """
    started = time.perf_counter()
    if not radii:
        raise UsageError("at least one perturbation radius is required")
    options = options or Options()
    network, contract = load(policy, specification)
    if not contract.requirements and contract.reward is None:
        raise InputError("a specification needs a requirement or a reward", remedy="say what has to hold")
    loops = tuple(bind(contract, network, plant, radius) for radius in radii)
    if part is not None:
        loops, check = tuple(_within(loop, part) for loop in loops), False
    deadline = deadline or Deadline.after(options.timeout)
    loaded = time.perf_counter()
    job, files = _Job(loops, options), evidence_files(loops[0], plant)
    found, doubts, falsification = _explore(job, files, deadline, progress)
    refused = [_ill_conditioned(job, found, problem) for problem in range(len(loops))]
    # what is proved with e_L added is proved without; only the rest of a refused network is worth a second run
    unproved = [bool(found.cells_of(problem, FAILED).size) for problem in range(len(loops))]
    if options.deployed and any(np.logical_and(refused, unproved)) and not deadline.expired:
        # decided for exact arithmetic all the same, for every radius alike
        job = _Job(loops, replace(options, deployed=False))
        exact, exact_doubts, again = _explore(job, files, deadline, progress)
        falsification += again
    else:
        exact, exact_doubts = found, doubts
    finished = time.perf_counter()
    timings = {"load": loaded - started, "reachability": finished - loaded - falsification}
    if falsification:
        timings["falsification"] = falsification
    results = []
    for problem, loop in enumerate(loops):
        relaxed = refused[problem] and unproved[problem]
        chosen, some = (exact, exact_doubts) if relaxed else (found, doubts)
        semantics = ["real"]
        notes = []
        if options.deployed and not refused[problem]:
            semantics.append(loop.policy.precision)
            notes += _runtime_notes(loop)
        elif refused[problem]:
            notes.append(
                f"{loop.policy.precision} execution is not covered: its error bound is {refused[problem]:.2g} of the "
                f"action range, more than {ILL_CONDITIONED:.0%}; rescale the network's weights"
            )
        doubt = some.get(problem)
        # positive polarity: every leaf of the cover was proved, and there is a cover
        leaves = chosen.cells_of(problem, PROVED, FAILED)
        everything = leaves.size > 0 and bool((chosen.status[leaves] == PROVED).all())
        if everything and (doubt is None or doubt.witness is None):
            doubt = None  # a simulation that touches the boundary, which no trajectory crosses
        if doubt is not None and doubt.objection:
            what = (
                "is not proved for the deployed network" if doubt.witness else "that a simulation shows is not proved"
            )
            notes.append(f"the violation {what}: {doubt.objection}")
        result = _result(job, chosen, problem, everything, doubt, tuple(semantics), tuple(notes), timings)
        if result.verdict is Verdict.CLAIMED and isinstance(files, str):
            result = replace(result, notes=(*result.notes, f"not checked: {files}"))
        elif result.verdict is Verdict.CLAIMED and not isinstance(files, str):
            result = _with_certificate(result, job, chosen, problem, files)
            watch = getattr(progress, "checking", None)
            if check:
                result = certified(result, files, deadline, workers, watch)
            else:
                note = "not checked, as asked for: `setrl check` says whether the certificate proves this"
                result = replace(result, notes=(*result.notes, note))
        results.append(result)
    require_no_contradiction(results)
    return results


def _within(loop: ClosedLoop, part: Part) -> ClosedLoop:
    """The loop that starts in a box within its initial set."""
    inside = all(low <= a <= b <= high for (a, b), (low, high) in zip(part, loop.initial, strict=True))
    if not inside:
        raise UsageError("a part of the initial set is not within it", where="part")
    return replace(loop, initial=part)


def _with_certificate(result: Result, job: _Job, found: Exploration, problem: int, files: EvidenceFiles) -> Result:
    """A claim, and the certificate that states it."""
    loop = job.loops[problem]
    started = time.perf_counter()
    runtime = None
    if len(result.semantics) == 2:
        runtime = runtime_name(), runtime_error(loop.policy.precision)
    radius = None if files.radius == loop.observation_radius else loop.observation_radius
    content = certificate_of(found, problem, job.options, files.digests, loop, radius, runtime)
    timings = {**result.timings, "certificate": time.perf_counter() - started}
    return replace(result, certificate=content, timings=timings)


@dataclass(frozen=True)
class _Doubt:
    """A simulated violation, the witness that the checker made of it, and what is not proved."""

    candidate: Candidate
    witness: ProvedWitness | None
    objection: str


def _explore(
    job: _Job, files: EvidenceFiles | str, deadline: Deadline, progress: Progress | None
) -> tuple[Exploration, dict[int, _Doubt], float]:
    """What the engine found, the simulated violations, and the seconds that it took to look for those."""
    model = prepare(job.loops[0])
    initial = InitialSet.of(*initial_box(model.loop))
    engine = Engine(model, job.options, initial.free.size + model.constant.size)
    doubts: dict[int, _Doubt] = {}
    seconds = 0.0

    def timed(problem: int, factors: Array) -> bool:
        nonlocal seconds
        started = time.perf_counter()
        answer = doubt(problem, factors)
        seconds += time.perf_counter() - started
        return answer

    def doubt(problem: int, factors: Array) -> bool:
        """Whether to give up: where a violation is proved, or is all that can be said."""
        loop = job.loops[problem]
        states = np.tile(initial.center, (len(factors), 1))
        states[:, initial.free] += factors * initial.radius[initial.free]
        low, high = (np.array([float(b[side]) for b in model.loop.initial]) for side in (0, 1))
        extremes = np.clip(states, low, high)
        candidate = propose(loop, extremes, stop=lambda: deadline.expired)
        if candidate is None:
            return False
        doubts[problem] = _doubt(loop, candidate, files, job.options.deployed, deadline)
        if doubts[problem].witness is None and not isinstance(files, str):
            for other in propose_all(loop, extremes, stop=lambda: deadline.expired):
                again = _doubt(loop, other, files, job.options.deployed, deadline)
                if again.witness is not None:
                    doubts[problem] = again
                    break
        return doubts[problem].witness is not None or isinstance(files, str)

    radii = np.stack([observation_radius(loop) for loop in job.loops])
    return explore(engine, radii, deadline, progress, timed), doubts, seconds


def _doubt(
    loop: ClosedLoop, candidate: Candidate, files: EvidenceFiles | str, deployed: bool, deadline: Deadline
) -> _Doubt:
    return _Doubt(candidate, *proved_witness(loop, candidate, files, deployed, deadline))


def _ill_conditioned(job: _Job, found: Exploration, problem: int) -> float:
    """e_L as a share of the action range where that is too much, else 0.

    The largest one of the proved cells; those without a proof do not count, for their sets may be arbitrarily large.
    Where nothing is proved, e_L may be the reason: then the one at a single point, from which no set is better.
    """
    loop = job.loops[problem]
    proved, failed = found.cells_of(problem, PROVED), found.cells_of(problem, FAILED)
    leaves = proved if proved.size else failed
    if not leaves.size:
        return 0.0
    span = found.action_upper[leaves].max(0) - found.action_lower[leaves].min(0)
    if loop.clip is not None:
        span = np.maximum(span, [float(high - low) for low, high in loop.clip])
    last = [layer for layer in loop.policy.layers if not hasattr(layer, "weight")][-1:]
    if loop.after is None and last and last[0] is loop.policy.layers[-1] and last[0].kind in ("tanh", "sigmoid"):
        span = np.maximum(span, 2.0 if last[0].kind == "tanh" else 1.0)
    error = found.deployed_error[leaves].max(0) if proved.size else _error_at_a_point(job)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = error / np.where(span > 0.0, span, np.nan)
    worst = float(np.nanmax(share)) if np.isfinite(share).any() else 0.0
    return worst if worst > ILL_CONDITIONED else 0.0


def _error_at_a_point(job: _Job) -> Array:
    """e_L at the middle of the initial set, shape (m,)."""
    model = prepare(job.loops[0])
    middle, _ = rounding.center_radius(*initial_box(model.loop))
    states, seen = middle.size, len(model.loop.observation_radius)
    engine = Engine(model, job.options)
    cells = engine.start(middle[None], np.zeros((1, 0, states)), np.zeros((1, states)), np.zeros((1, seen)))
    period, _ = engine.advance(0, cells)
    error: Array = period.deployed_error[0]
    return error


def _runtime_notes(loop: ClosedLoop) -> list[str]:
    kinds = {getattr(layer, "kind", "") for layer in loop.policy.layers}
    note = runtime_note() if kinds & {"tanh", "sigmoid"} else None
    return [note] if note else []


def _result(
    job: _Job,
    found: Exploration,
    problem: int,
    verified: bool,
    doubt: _Doubt | None,
    semantics: tuple[str, ...],
    notes: tuple[str, ...],
    timings: dict[str, float],
) -> Result:
    loop = job.loops[problem]
    leaves = found.cells_of(problem, PROVED, FAILED)
    candidate, witness = (None, None) if doubt is None else (doubt.candidate, doubt.witness)
    if verified and witness is not None:
        raise AssertionError(f"the engine proved every cell, and the checker a violation: {witness.sentence}")
    verdict = Verdict.CLAIMED if verified else Verdict.FALSIFIED if witness is not None else Verdict.UNKNOWN
    reason = None if verified else explain(loop, job.options, found, problem, candidate)
    if reason is not None and witness is not None:
        reason = replace(reason, sentence=witness.sentence)
    value = _value(loop, found, problem, leaves)
    cells = int((found.tree.problem == problem).sum())
    return Result(
        verdict,
        reason,
        _requirements(loop, found, leaves),
        value,
        _flowpipe(loop, found, leaves, problem),
        semantics,
        float(found.deployed_error[leaves].max(initial=0.0)),
        cells,
        int(leaves.size),
        candidate,
        dict(timings),
        claim_sentence(loop, semantics),
        notes,
        loop,
        tuple(float(radius) for radius in loop.observation_radius),
        witness,
        cover=tuple(cover_of(found, problem, loop)[0]),
    )


def _requirements(loop: ClosedLoop, found: Exploration, leaves: NDArray[np.intp]) -> tuple[RequirementResult, ...]:
    results = []
    for number, requirement in enumerate(loop.requirements):
        margins = found.margins[leaves, number]
        worst = int(margins.argmin())
        margin, when = float(margins[worst]), float(found.times[leaves[worst], number])
        facet = ""
        place = found.failing.get(int(leaves[worst]))
        if place is not None and place[0] == number:
            facet = _facet(requirement, place[1])
        results.append(
            RequirementResult(
                requirement.name,
                requirement.kind,
                bool((margins > 0.0).all()) and bool((found.status[leaves] == PROVED).all()),
                margin,
                None if np.isnan(when) else when,
                facet,
                requirement.line,
            )
        )
    return tuple(results)


def _facet(requirement: Any, place: Any) -> str:
    """Text of the facet that decides the margin of a failing set."""
    best, text = -np.inf, ""
    for member in requirement.region:
        facets = prepare_polytope(member)
        if requirement.kind == "avoid":
            margin, which = facet_separation(place, facets)
            value, words = float(margin[0]), facets.texts[int(which[0])]
        else:
            margins = containment_margins(place, facets)[0]
            value, words = float(margins.min()), facets.texts[int(margins.argmin())]
        if value > best or not text:
            best, text = value, words
    return text


def _value(loop: ClosedLoop, found: Exploration, problem: int, leaves: NDArray[np.intp]) -> Value | None:
    if loop.reward is None:
        return None
    root = problem
    # a cover's worst leaf, or the root's own run, whichever bound is better: both are lower bounds of every return
    discounted = max(float(found.value[leaves].min()), float(found.value[root]))
    undiscounted = max(float(found.undiscounted[leaves].min()), float(found.undiscounted[root]))
    return Value(discounted, undiscounted, float(loop.reward.discount))


def _flowpipe(loop: ClosedLoop, found: Exploration, leaves: NDArray[np.intp], problem: int) -> Flowpipe:
    kept = [found.hulls[int(cell)] for cell in leaves if int(cell) in found.hulls] or [
        found.hulls[cell] for cell in (problem,) if cell in found.hulls
    ]
    states = len(loop.plant.states)
    points = np.array([k[0] for k in kept]).reshape(len(kept), loop.periods + 1, 2, states)
    intervals = np.array([k[1] for k in kept]).reshape(len(kept), loop.periods * PARTS, 2, states)
    curves = np.array([k[2] for k in kept]).reshape(len(kept), len(loop.requirements), loop.periods + 1)
    return Flowpipe(float(loop.period), loop.plant.states, points, intervals, curves)


def example() -> tuple[str, str]:
    """Path of the shipped policy and the name of the specification it was made for."""
    from ..models import example as shipped

    path = str(shipped.example_policy_path())
    if not os.path.exists(path):
        raise SetrlError("the shipped example policy is missing", where=path, remedy="reinstall setrl")
    return path, shipped.EXAMPLE_SPECIFICATION
