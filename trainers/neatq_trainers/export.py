"""`neatq export`: the champion of a run for other programs."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from torch import Tensor, nn

from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import LARGEST, EnvFacts, ObservationScaling
from neatq_torch.atomic import write_atomic
from neatq_torch.genome import Genome, load_genome
from neatq_torch.interop import to_c, to_graphviz, to_onnx, to_python
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.network import Evaluation, GenomeNetwork
from neatq_trainers.commands import parse
from neatq_trainers.folder import CHAMPION, CHECKPOINT, SCALING, load_run
from neatq_trainers.policy import ChampionPolicy, load_policy
from neatq_trainers.worlds import GymnasiumConfig


@dataclass(frozen=True, kw_only=True)
class ExportCommand:
    """Write the champion of a run for other programs.

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


class ActingChampion(nn.Module):
    """What a policy does, as a pure function (observation, state) -> (action, state).

    Args:
        policy: What acts.
        scaling: Of its observations.
        double_activation: As `CandidatePolicy` has it; the state then ends with the observation
            before.
    """

    def __init__(
        self,
        policy: ChampionPolicy,
        scaling: ObservationScaling | None = None,
        *,
        double_activation: bool = False,
    ) -> None:
        super().__init__()
        self.network, self.heads = policy.network, policy.heads
        self._scaling = None  # no buffers, as in the policy
        if scaling is not None:
            self._scaling = torch.from_numpy(scaling.offset), torch.from_numpy(scaling.scale)
        self._first = _first_choice(policy.interface)
        self._twice = double_activation and bool(self.network.state_size)
        self.inputs = self.network.inputs

    @property
    def state_size(self) -> int:
        """Numbers that are kept from call to call."""
        return self.network.state_size + self.inputs * self._twice

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """Zeros [*batch, state_size]."""
        return self.network.weight.new_zeros(*batch, self.state_size)

    def step(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """The action, whole numbers [*batch] of choices or [*batch, A], and the next state."""
        seen = observation
        if self._scaling is not None:
            offset, scale = self._scaling
            seen = ((seen.double() - offset) / scale).clamp(-LARGEST, LARGEST).to(seen.dtype)
        size = self.network.state_size
        output, kept = self.network.step(seen, state[..., :size])
        if self._twice:
            kept = self.network.step(state[..., size:], kept)[1]
            kept = torch.cat([kept, seen], -1)
        return self._best(output), kept

    def _best(self, output: Tensor) -> Tensor:
        # As `Heads.best`, whose take_along_dim would tie what is exported to one size of batch.
        candidates, values = self.heads(output)
        number = values.argmax(-1, keepdim=True)
        if self._first is not None:
            return number[..., 0] + self._first
        index = number.unsqueeze(-1).expand(*number.shape, self.heads.actions)
        return candidates.gather(-2, index).squeeze(-2)


@dataclass(frozen=True, kw_only=True)
class Travelling:
    """What is to be written."""

    genome: Genome
    evaluation: Evaluation = "settle"
    acting: ActingChampion | None = None
    scaling: ObservationScaling | None = None
    comment: tuple[str, ...] = ()

    def write(self, command: ExportCommand) -> list[Path]:
        """Write the files that are asked for; gives their names."""
        scaling = None
        if self.scaling is not None:
            scaling = self.scaling.offset, self.scaling.scale, LARGEST
        given: dict[str, Any] = {
            "evaluation": self.evaluation,
            "scaling": scaling,
            "comment": self.comment,
        }
        if command.c is not None:
            write_atomic(command.c, to_c(self.genome, name=_identifier(command.c), **given))
        if command.python is not None:
            write_atomic(command.python, to_python(self.genome, **given))
        if command.dot is not None:
            write_atomic(command.dot, to_graphviz(self.genome))
        if command.onnx is not None:
            network = self.acting or GenomeNetwork(self.genome, evaluation=self.evaluation)
            name = "output" if self.acting is None else "action"
            metadata = {"neatq": "\n".join(self.comment)}
            to_onnx(network, command.onnx, output_name=name, metadata=metadata)
        written = command.onnx, command.c, command.python, command.dot
        return [path for path in written if path is not None]


def export_command(arguments: list[str]) -> None:
    """`neatq export`."""
    command = parse(ExportCommand, "export", arguments)
    if not (command.onnx or command.c or command.python or command.dot):
        raise ConfigError("export: expected at least one of --onnx, --c, --python and --dot FILE")
    try:
        travelling = _travelling(command.run)
        written = travelling.write(command)
    except ModuleNotFoundError as error:
        raise ConfigError(f"export: {error}") from error
    print(f"neatq: {', '.join(map(str, written))}")
    for line in travelling.comment:
        print(f"neatq: {line}")


def _travelling(path: Path) -> Travelling:
    """The champion of a run, whose folder or champion.json is given, or any other genome."""
    if path.name == CHAMPION and (path.parent / CHECKPOINT).is_file():
        path = path.parent
    if path.is_file():
        return Travelling(genome=load_genome(path))
    run, policy = load_run(path), load_policy(path)
    if not isinstance(policy, ChampionPolicy):
        raise ConfigError(f"{path}: {run.config.arm} has a table and no network to export")
    scaling = None
    if isinstance(run.config.world, GymnasiumConfig):
        facts = EnvFacts.from_dict(json.loads((path / SCALING).read_bytes()))
        scaling = facts.scaling
    network = run.config.network
    acting = ActingChampion(policy, scaling, double_activation=network.double_activation)
    comment = (
        f"The champion of {run.config.arm} on {run.config.task}.",
        _what_it_takes(policy),
        *what_it_gives(policy.heads, _first_choice(policy.interface) or 0),
        *_what_is_whole(policy.interface),
    )
    if network.double_activation:
        comment += (
            "Twice a tick: after each call, call it with the observation before (zeros at first),",
            "and ignore what it gives; the ONNX file does so itself.",
        )
    genome, evaluation = run.champion(), network.evaluation
    return Travelling(
        genome=genome, evaluation=evaluation, acting=acting, scaling=scaling, comment=comment
    )


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
        f"low {[round(one, 6) for one in low]}, high {[round(one, 6) for one in high]}."
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
