"""`neatq export`: the champion of a run for other programs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from gymnasium import spaces
from torch import Tensor, nn

from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import LARGEST, ObservationScaling
from neatq_torch.atomic import write_atomic
from neatq_torch.genome import Genome, load_genome
from neatq_torch.interop import to_c, to_graphviz, to_onnx, to_python
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.network import GenomeNetwork
from neatq_trainers.commands import parse
from neatq_trainers.folder import CHAMPION, CHECKPOINT, load_run
from neatq_trainers.policy import ChampionPolicy, load_policy

MOST_TICKS = 20_000
"""Of a page: a thousand are about a megabyte for fifty robots."""


@dataclass(frozen=True, kw_only=True)
class ExportCommand:
    """Write the champion of a run for other programs, or a life of its team as a page.

    All files take observations as the environment gives them, flat and not scaled: where a run
    scales observations, that is part of what is written. The ONNX file gives the action; the
    sources give the outputs of the network and say at their top how the action is read from them.
    A champion that remembers has a state: zeros where an episode begins, and from then on what the
    call before gave.
    """

    run: tyro.conf.Positional[Path]
    """A run folder, or the file of a genome, which is written as the bare network (settle)."""
    onnx: Path | None = None
    """For ONNX Runtime: observation [batch, inputs] to action; state and next_state beside them.
    Of a bare network it gives the output [batch, outputs]."""
    c: Path | None = None
    """A header in C99 with the function NAME_step, NAME being that of the file."""
    python: Path | None = None
    """Plain Python with the function step."""
    dot: Path | None = None
    """The graph of the genome, for Graphviz."""
    html: Path | None = None
    """A page for any browser, in one file, that plays what the team of a run in the arena or on
    NERO's field does in its next ticks; nobody but the page is needed."""
    ticks: int = 1000
    """Of that page."""


class ActingChampion(nn.Module):
    """What a policy does, as a pure function (flat observation, state) -> (action, state)."""

    def __init__(self, policy: ChampionPolicy) -> None:
        super().__init__()
        self.policy, self.inputs = policy, policy.network.inputs
        self._first = _first_choice(policy.interface)

    @property
    def state_size(self) -> int:
        """Numbers that are kept from call to call."""
        return self.policy.state_size

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """Zeros [*batch, state_size]."""
        return self.policy.initial_state(batch)

    def step(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """The action, whole numbers [*batch] of choices or [*batch, A], and the next state."""
        best, state = self.policy.best(self.policy.scaled(observation), state)
        return best if self._first is None else best[..., 0].long() + self._first, state


def export_command(arguments: list[str]) -> None:
    """`neatq export`."""
    command = parse(ExportCommand, "export", arguments)
    if not (command.onnx or command.c or command.python or command.dot or command.html):
        raise ConfigError(
            "export: expected at least one of --onnx, --c, --python, --dot and --html FILE"
        )
    if command.html is not None:
        _write_page(command.run, command.html, command.ticks)
    if not (command.onnx or command.c or command.python or command.dot):
        return
    genome, policy, comment = _champion_at(command.run)
    try:
        _write(command, genome, policy, comment)
    except ModuleNotFoundError as error:
        raise ConfigError(f"export: {error}") from error
    written = command.onnx, command.c, command.python, command.dot
    print(f"neatq: {', '.join(str(path) for path in written if path is not None)}")
    for line in comment:
        print(f"neatq: {line}")


def _write_page(run: Path, path: Path, ticks: int) -> None:
    from neatq_trainers.live.recording import page_with, record_life

    if not 1 <= ticks <= MOST_TICKS:
        raise ConfigError(f"ticks: expected 1 to {MOST_TICKS:,}, got {ticks:,}")
    write_atomic(path, page_with(record_life(load_run(run), ticks)))
    print(f"neatq: {path}")


def _write(
    command: ExportCommand, genome: Genome, policy: ChampionPolicy | None, comment: Sequence[str]
) -> None:
    """Write the files that are asked for."""
    network = GenomeNetwork(genome) if policy is None else policy.network
    given: dict[str, Any] = {"evaluation": network.evaluation, "comment": comment}
    if policy is not None and policy.scaling is not None:
        given["scaling"] = policy.scaling.offset, policy.scaling.scale, LARGEST
    if command.c is not None:
        write_atomic(command.c, to_c(genome, name=_identifier(command.c), **given))
    if command.python is not None:
        write_atomic(command.python, to_python(genome, **given))
    if command.dot is not None:
        write_atomic(command.dot, to_graphviz(genome))
    if command.onnx is not None:
        acting, name = (network, "output") if policy is None else (ActingChampion(policy), "action")
        metadata = {"neatq": "\n".join(comment)}
        to_onnx(acting, command.onnx, output_name=name, metadata=metadata)


def _champion_at(path: Path) -> tuple[Genome, ChampionPolicy | None, list[str]]:
    """The champion of a run, whose folder or champion.json is given, or any other genome.

    With it come what acts with it in its run, and words on how it does.
    """
    if path.name == CHAMPION and (path.parent / CHECKPOINT).is_file():
        path = path.parent
    if path.is_file():
        return load_genome(path), None, []
    run = load_run(path)
    policy = load_policy(run)
    if not isinstance(policy, ChampionPolicy):
        raise ConfigError(f"{path}: {run.config.arm} has a table and no network to export")
    comment = [
        f"The champion of {run.config.arm} on {run.config.task}.",
        _what_it_takes(policy),
        *what_it_gives(policy.heads, _first_choice(policy.interface) or 0),
        *_what_is_whole(policy.interface),
        *what_is_lost(policy.scaling),
    ]
    if policy.twice:
        comment += [
            "Twice a tick: after each call, call it with the observation before (zeros at first),",
            "and ignore what it gives; the ONNX file does so itself.",
        ]
    return run.champion(), policy, comment


def _first_choice(interface: Interface | None) -> int | None:
    """The smallest action of a Discrete space; None for other actions."""
    space = None if interface is None else interface.action
    return int(space.start) if isinstance(space, spaces.Discrete) else None


def _what_it_takes(policy: ChampionPolicy) -> str:
    if policy.interface is None:
        return "observation: as the world gives it."
    space = " ".join(str(policy.interface.observation).split())
    return f"observation: {space} of the environment, flat; a Discrete one as ones and zeros."


def _what_is_whole(interface: Interface | None) -> list[str]:
    space = None if interface is None else interface.action
    if space is None or isinstance(space, spaces.Discrete):
        return []
    if isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.floating):
        return []
    words = " ".join(str(space).split())
    return [f"The environment takes {words}: round whole numbers down, to the greatest at most."]


def what_is_lost(scaling: ObservationScaling | None) -> list[str]:
    """A warning where the error of single precision is more than a thousandth of the scale."""
    if scaling is None or (np.abs(scaling.offset) * 2.0**-24 <= 1e-3 * scaling.scale).all():
        return []
    return ["Observations differ too little for single precision: only Python reads all digits."]


def what_it_gives(heads: Heads, first: int) -> list[str]:
    """How an action is read from outputs, in words; `first` is the action that choice 0 means."""
    if isinstance(heads, DiscreteHeads):
        plus = f" + {first}" if first else ""
        return [f"action: k{plus} where output[k] is greatest, of equal ones the first."]
    if not isinstance(heads, CandidateHeads):
        return [f"action: read from the outputs by {type(heads).__name__}."]
    candidates, actions = heads.candidates, heads.actions
    low, high = heads.low.tolist(), (heads.low + heads.span).tolist()
    lines = [
        f"action: low + (high - low) * u, u being outputs clipped to [0, 1], "
        f"low {[float(f'{one:.7g}') for one in low]}, high {[float(f'{one:.7g}') for one in high]}."
    ]
    if candidates > 1:
        first_value = candidates * actions
        lines.append(
            f"u: the {actions} outputs from {actions} * c on, for the c below {candidates} where "
            f"output[{first_value} + c] is greatest, of equal ones the first."
        )
    return lines


def _identifier(path: Path) -> str:
    """What the functions in a file are called: like the file, as far as C allows."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", path.stem)
    return name if re.match("[A-Za-z]", name) else f"network_{name}"
