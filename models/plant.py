"""Plants: from a text of expressions to a straight-line tape."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

from ..specs.errors import SpecificationError
from ..specs.expressions import Expression, Number, names_in
from ..specs.specification import PlantDescription
from .closed_loop import Plant
from .tape import Tape, compile_tape

PLANTS_FOLDER = Path(__file__).parent / "plants"


def shipped_plants() -> tuple[str, ...]:
    """Names of the plants that come with setrl, sorted."""
    return tuple(sorted(path.stem for path in PLANTS_FOLDER.glob("*.yaml")))


def load_plant(name_or_path: str | Path, relative_to: str | Path | None = None) -> Plant:
    """Read and compile a plant.

    Parameters
    ----------
    name_or_path : str or path
        A shipped plant's name (``unicycle``), or the path of a plant file (with a folder or ``.yaml``).
    relative_to : path, optional
        Folder that a relative path starts from; the current folder by default.

    Returns
    -------
    Plant

    Raises
    ------
    SpecificationError
        There is no such plant, or its text is wrong.
    """
    from ..specs.reader import read_plant

    return compile_plant(read_plant(_plant_path(str(name_or_path), relative_to)))


def _plant_path(text: str, relative_to: str | Path | None) -> Path:
    if "/" not in text and not text.endswith((".yaml", ".yml")):
        shipped = shipped_plants()
        if text not in shipped:
            raise SpecificationError(
                f"there is no shipped plant {text}",
                remedy=suggestion(text, shipped, "shipped plants") + "; a plant file is given with its .yaml",
            )
        return PLANTS_FOLDER / f"{text}.yaml"
    path = Path(text)
    if relative_to is not None and not path.is_absolute():
        path = Path(relative_to) / path
    if not path.is_file():
        raise SpecificationError(
            f"there is no plant file {text}",
            where=str(path.parent),
            remedy="a path starts at the specification's folder",
        )
    return path


def suggestion(wrong: str, known: Iterable[str], what: str) -> str:
    """The end of a message about an unknown name: the closest known one, or all of them."""
    names = list(known)
    close = difflib.get_close_matches(wrong, names, n=1)
    listed = ", ".join(names) or "none"
    return f"did you mean {close[0]}?" if close else f"{what}: {listed}"


def parameter_values(description: PlantDescription) -> dict[str, Expression]:
    """Parameters as exact constants, for `tape.compile_tape`."""
    return {name: Number(Fraction(value)) for name, (value, _) in description.parameters.items()}


def compile_plant(description: PlantDescription) -> Plant:
    """Compile a plant's text.

    Parameters
    ----------
    description : PlantDescription

    Returns
    -------
    Plant
        Its tape's inputs are states, inputs, disturbances; its outputs one per state.

    Raises
    ------
    SpecificationError
        A name is unknown or defined twice, or the dynamics do not cover exactly the states.
    """
    states, inputs, disturbances = (
        tuple(group) for group in (description.states, description.inputs, description.disturbances)
    )
    _require_distinct(description)
    _require_dynamics(description)
    known = {*states, *inputs, *disturbances, *description.parameters}
    for state in states:
        for name in sorted(names_in(description.dynamics[state])):
            if name not in known:
                raise SpecificationError(
                    f"the dynamics of {state} use {name}, which is no state, input, disturbance or parameter",
                    where=_where(description, state),
                    remedy=suggestion(name, sorted(known), "names"),
                )
    variables, parameters = (*states, *inputs, *disturbances), parameter_values(description)
    for state in states:
        if _divides_by_zero(compile_tape([description.dynamics[state]], variables, parameters)):
            raise SpecificationError(
                f"the dynamics of {state} divide by zero with these parameters",
                where=_where(description, state),
                remedy="change the parameters",
            )
    tape = compile_tape([description.dynamics[state] for state in states], variables, parameters)
    return Plant(states, inputs, disturbances, tape, description.discrete, description)


def _divides_by_zero(tape: Tape) -> bool:
    values: list[Fraction | None] = [None for _ in tape.inputs]
    values += [entry.value for entry in tape.instructions]
    return any(entry.operation == "divide" and values[entry.operands[1]] == 0 for entry in tape.instructions)


def _require_distinct(description: PlantDescription) -> None:
    if not description.states:
        raise SpecificationError("a plant needs at least one state", where=_where(description))
    seen: dict[str, str] = {}
    groups = {
        "state": description.states,
        "input": description.inputs,
        "disturbance": description.disturbances,
        "parameter": description.parameters,
    }
    for kind, names in groups.items():
        for name in names:
            if name in seen:
                raise SpecificationError(
                    f"{name} names a {seen[name]} and something else ({kind})",
                    where=_where(description, name),
                    remedy="rename one",
                )
            seen[name] = kind


def _require_dynamics(description: PlantDescription) -> None:
    for name in description.dynamics:
        if name not in description.states:
            raise SpecificationError(
                f"the dynamics have an entry for {name}, which is no state",
                where=_where(description, name),
                remedy=suggestion(name, description.states, "states"),
            )
    missing = [state for state in description.states if state not in description.dynamics]
    if missing:
        raise SpecificationError(
            f"every state needs dynamics; missing: {', '.join(missing)}",
            where=_where(description),
            remedy="add them, for example `x: 0` for a state that never changes",
        )


def _where(description: PlantDescription, state: str | None = None) -> str:
    source = description.source or f"plant {description.name}"
    line = description.lines.get(state, 0) if state is not None else 0
    return f"{source}:{line}" if line else source


def check_plant(plant: Plant) -> None:
    """The contract of a plant, as a function; users, documentation and tests call the same one.

    Raises
    ------
    AssertionError
        Naming the broken clause: order of the tape's inputs, one output per state, slots that are read before they
        are written, constants without a value, or a tape that no longer computes what the text says.
    """
    tape = plant.tape
    arity = {"constant": 0, "add": 2, "subtract": 2, "multiply": 2, "divide": 2}
    assert tape.inputs == (*plant.states, *plant.inputs, *plant.disturbances), "tape inputs are not the plant's names"
    assert len(set(tape.inputs)) == len(tape.inputs), "a name is used twice"
    assert len(tape.outputs) == len(plant.states), "not one output per state"
    for position, instruction in enumerate(tape.instructions):
        slot = len(tape.inputs) + position
        assert len(instruction.operands) == arity.get(instruction.operation, 1), (
            f"slot {slot} has a wrong operand count"
        )
        assert all(0 <= operand < slot for operand in instruction.operands), f"slot {slot} reads a later slot"
        assert (instruction.operation == "constant") == (instruction.value is not None), f"slot {slot} has no value"
    assert all(0 <= output < len(tape.inputs) + len(tape.instructions) for output in tape.outputs), (
        "output out of range"
    )
    assert compile_plant(plant.description).tape == tape, "the tape is not what the text compiles to"
