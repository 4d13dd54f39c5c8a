"""Every option of a training run and its default: frozen dataclasses, validated when they are made.

The defaults are Table 2 of the paper, except where `PAPER` differs from them: docs/train.md
says why, and `PAPER` holds the table to the letter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args, get_type_hints

from ..specs.errors import UsageError

Algorithm = Literal["pa-pc", "naive", "grad", "mad", "sa-pc", "sa-sc"]
ALGORITHMS: tuple[str, ...] = get_args(Algorithm)


@dataclass(frozen=True)
class FlowpipeOptions:
    """Second phase: ascend V(s0) or the smallest requirement margin through the reachable sets.

    Attributes
    ----------
    steps : int
        Gradient steps; 0: no second phase.
    objective : {"value", "margin", "both"}
    epsilon : float or None
        Largest perturbation radius; None: five times the specification's.
    pairs : int
        Pairs of a start and a radius per step and seed.
    learning_rate, final_learning_rate : float
        Adam's, decaying geometrically from the first to the second.
    clip : float
        Largest norm of a seed's gradient.
    """

    steps: int = 0
    objective: Literal["value", "margin", "both"] = "value"
    epsilon: float | None = None
    pairs: int = 8
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-4
    clip: float = 1.0

    def __post_init__(self) -> None:
        _check_types(self, "flowpipe.")
        _require_range(self, "flowpipe.", {"steps": (0, 10**6), "pairs": (1, 4096)})
        _require_positive(self, "flowpipe.", ("learning_rate", "final_learning_rate", "clip"))
        if self.epsilon is not None and not (self.epsilon >= 0.0 and math.isfinite(self.epsilon)):
            raise UsageError(f"a radius is a finite number >= 0, received {self.epsilon}", where="flowpipe.epsilon")


@dataclass(frozen=True)
class TrainingOptions:
    """Options of one run; symbols as in the paper.

    Attributes
    ----------
    algorithm : str
        One of `ALGORITHMS`.
    base : {"ddpg", "td3"}
    seeds, first_seed : int
        Seeds first_seed ... first_seed + seeds - 1 are trained side by side.
    episodes : int
    hidden : tuple of int
        Widths of the hidden layers of actor and critic.
    actor_learning_rate, critic_learning_rate : float
    critic_decay : float
        L2 weight regularisation of the critic, lambda_Q (coupled: added to the gradient).
    discount : float or None
        gamma; None: the specification's.
    target_update : float
        tau, share of the online network that moves into the target network per update.
    exploration : float
        Standard deviation sigma of the noise on the action.
    exploration_process : {"normal", "ornstein-uhlenbeck"}
    batch, buffer, warmup : int
        Transitions per update; stored at most; stored before the first update.
    epsilon : float or None
        Perturbation radius of the training; None: the specification's largest. Components keep the proportions of the
        specification's radii.
    actor_weight, critic_weight : float
        eta_mu and eta_Q.
    omega : float
        Share of the action set in the actor's volume penalty of sa-sc, in [0, 1].
    floor : float
        Added to every radius inside the logarithm: ln(2 (|G| 1 + floor)); keeps a set from collapsing.
    gradients : {"detached", "exact"}
        Whether slopes, offsets and errors of relaxations are constants of the set gradient.
    time_limit : {"terminal", "bootstrap"}
        What the last step of the horizon is to the critic.
    goal_stop : float
        An episode of training ends once every weighted state is so close to its target; 0: never.
    policy_delay : int
        TD3: critic updates per actor update.
    smoothing, smoothing_clip : float
        TD3: noise on the target action, and its bound.
    attack_steps : int
        Gradient steps of `mad`, candidates of `naive`.
    validation_epsilon : float or None
        Radius at which V selects checkpoints; None: `epsilon`.
    validation_every : int
        Episodes between validations; 0: only at the end.
    checkpoint_every : int
        Episodes between checkpoints.
    precision : {"float32", "float64"}
    device : {"cpu", "cuda"}
    compile : bool
        Compile the update with `torch.compile`: faster after half a minute.
    flowpipe : FlowpipeOptions
    """

    algorithm: Algorithm = "sa-pc"
    base: Literal["ddpg", "td3"] = "ddpg"
    seeds: int = 1
    first_seed: int = 0
    episodes: int = 2000
    hidden: tuple[int, ...] = (64, 32)
    actor_learning_rate: float = 1e-4
    critic_learning_rate: float = 1e-3
    critic_decay: float = 0.0
    discount: float | None = None
    target_update: float = 0.05
    exploration: float = 0.1
    exploration_process: Literal["normal", "ornstein-uhlenbeck"] = "normal"
    batch: int = 64
    buffer: int = 1_000_000
    warmup: int = 64
    epsilon: float | None = None
    actor_weight: float = 0.02
    critic_weight: float = 0.01
    omega: float = 0.5
    floor: float = 0.0
    gradients: Literal["detached", "exact"] = "detached"
    time_limit: Literal["terminal", "bootstrap"] = "terminal"
    goal_stop: float = 0.05
    policy_delay: int = 2
    smoothing: float = 0.2
    smoothing_clip: float = 0.5
    attack_steps: int = 10
    validation_epsilon: float | None = None
    validation_every: int = 100
    checkpoint_every: int = 200
    precision: Literal["float32", "float64"] = "float32"
    device: Literal["cpu", "cuda"] = "cpu"
    compile: bool = False
    flowpipe: FlowpipeOptions = field(default_factory=FlowpipeOptions)

    def __post_init__(self) -> None:
        _check_types(self, "")
        ranges = {"seeds": (1, 1000), "first_seed": (0, 2**32 - 1), "episodes": (0, 10**8), "batch": (1, 10**6)}
        ranges |= {"buffer": (1, 10**9), "warmup": (1, 10**9), "policy_delay": (1, 1000), "attack_steps": (1, 1000)}
        ranges |= {"validation_every": (0, 10**8), "checkpoint_every": (1, 10**8)}
        _require_range(self, "", ranges)
        _require_positive(self, "", ("actor_learning_rate", "critic_learning_rate", "smoothing_clip"))
        for name in ("critic_decay", "exploration", "actor_weight", "critic_weight", "floor", "goal_stop", "smoothing"):
            _require_radius(name, getattr(self, name))
        for name in ("epsilon", "validation_epsilon"):
            if getattr(self, name) is not None:
                _require_radius(name, getattr(self, name))
        for name, value in (("discount", self.discount), ("target_update", self.target_update)):
            if value is not None and not (0.0 < value <= 1.0):
                raise UsageError(f"a number above 0 and at most 1 is required, received {value}", where=name)
        if not (0.0 <= self.omega <= 1.0):
            raise UsageError(f"a number from 0 to 1 is required, received {self.omega}", where="omega")
        if not self.hidden or not all(1 <= width <= 4096 for width in self.hidden):
            received = " ".join(map(str, self.hidden)) or "none"
            raise UsageError(f"widths of hidden layers are from 1 to 4096, received {received}", where="hidden")
        if self.warmup > self.buffer:
            raise UsageError(f"at most the buffer's {self.buffer} transitions, received {self.warmup}", where="warmup")

    @property
    def seed_numbers(self) -> tuple[int, ...]:
        """The seeds of this run."""
        return tuple(range(self.first_seed, self.first_seed + self.seeds))


PAPER: dict[str, dict[str, Any]] = {
    "ddpg": {"critic_decay": 0.01, "epsilon": 0.1, "actor_weight": 0.1, "critic_weight": 0.01},
    "td3": {"critic_decay": 0.0, "epsilon": 0.1, "actor_weight": 0.1, "critic_weight": 0.01},
}
"""What Table 2 of the paper says where the defaults differ, by `base`."""


def options_from(values: dict[str, Any]) -> TrainingOptions:
    """Options from plain data, as a configuration file or a checkpoint has them.

    Raises
    ------
    UsageError
        A key is unknown, or a value is of the wrong type or out of range.
    """
    options: TrainingOptions = _from_plain(TrainingOptions, values, "")
    return options


def plain(options: TrainingOptions) -> dict[str, Any]:
    """Options as plain data: `options_from(plain(o)) == o`."""
    from dataclasses import asdict

    data = asdict(options)
    data["hidden"] = list(options.hidden)
    return data


def _from_plain(kind: Any, values: Any, prefix: str) -> Any:
    from difflib import get_close_matches

    if not isinstance(values, dict):
        raise UsageError(f"options by name are required, received {values!r}", where=prefix.rstrip(".") or "options")
    known = {entry.name for entry in fields(kind)}
    arguments = {}
    for key, value in values.items():
        if key not in known:
            near = get_close_matches(str(key), known, 1)
            remedy = f"did you mean {near[0]}?" if near else f"options: {', '.join(sorted(known))}"
            raise UsageError(f"there is no option {key}", where=f"{prefix}{key}", remedy=remedy)
        if key == "flowpipe" and kind is TrainingOptions and not isinstance(value, FlowpipeOptions):
            value = _from_plain(FlowpipeOptions, value, "flowpipe.")
        arguments[key] = tuple(value) if isinstance(value, list) else value
    return kind(**arguments)


def _check_types(options: Any, prefix: str) -> None:
    """Each field has the type that its annotation says; a whole number is a number."""
    hints = get_type_hints(type(options))
    for entry in fields(options):
        value, hint = getattr(options, entry.name), hints[entry.name]
        where = prefix + entry.name
        choices = get_args(hint)
        if choices and all(isinstance(choice, str) for choice in choices):
            if value not in choices:
                raise UsageError(f"received {value!r}", where=where, remedy=f"choose from: {', '.join(choices)}")
        elif hint is int and (isinstance(value, bool) or not isinstance(value, int)):
            raise UsageError(f"a whole number is required, received {value!r}", where=where)
        elif hint is bool and not isinstance(value, bool):
            raise UsageError(f"true or false is required, received {value!r}", where=where)
        elif float in (hint, *choices) and not (value is None and type(None) in choices):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise UsageError(f"a number is required, received {value!r}", where=where)
            object.__setattr__(options, entry.name, float(value))
        elif hint == tuple[int, ...] and not (
            isinstance(value, tuple) and all(isinstance(n, int) and not isinstance(n, bool) for n in value)
        ):
            raise UsageError(f"a list of whole numbers is required, received {value!r}", where=where)


def _require_range(options: Any, prefix: str, ranges: dict[str, tuple[int, int]]) -> None:
    for name, (least, most) in ranges.items():
        value = getattr(options, name)
        if not (least <= value <= most):
            raise UsageError(
                f"a whole number from {least} to {most} is required, received {value}", where=prefix + name
            )


def _require_positive(options: Any, prefix: str, names: tuple[str, ...]) -> None:
    for name in names:
        value = getattr(options, name)
        if not (0.0 < value < math.inf):
            raise UsageError(f"a finite number > 0 is required, received {value}", where=prefix + name)


def _require_radius(name: str, value: float) -> None:
    if not (0.0 <= value < math.inf):
        raise UsageError(f"a finite number >= 0 is required, received {value}", where=name)
