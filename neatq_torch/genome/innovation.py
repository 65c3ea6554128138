"""Who numbered which structure: the historical markings of a run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple, Self

from neatq_torch.genome.genome import Genome


class LinkInnovation(NamedTuple):
    """Number of a link and the weight it had when it first appeared."""

    innovation: int
    weight: float


class Split(NamedTuple):
    """The node that splits a link, and the numbers of the two links around it."""

    node_id: int
    in_innovation: int
    out_innovation: int


class InnovationLedger:
    """Gives equal structural mutations equal numbers, until it is told to `forget` them.

    A link that appears again gets the weight of its first occurrence. In OpenNERO's rtNEAT the
    list is never cleared, in NEAT after every generation. It is part of a run's state.
    """

    def __init__(self, next_innovation: int = 1, next_node_id: int = 1, step: int = 1) -> None:
        """Start an empty ledger whose first new link and node get these numbers, then each step."""
        self.next_innovation = next_innovation
        self.next_node_id = next_node_id
        self.step = step
        self._links: dict[tuple[int, int, bool], LinkInnovation] = {}
        self._splits: dict[int, list[Split]] = {}

    @classmethod
    def for_genomes(cls, genomes: Iterable[Genome]) -> Self:
        """Return a ledger that knows the links of these genomes and numbers beyond them."""
        ledger = cls()
        columns = ("source", "target", "recurrent", "innovation", "weight")
        for genome in genomes:
            lists = [getattr(genome, f"link_{column}").tolist() for column in columns]
            for source, target, recurrent, innovation, weight in zip(*lists, strict=True):
                known = LinkInnovation(innovation, weight)
                ledger._links.setdefault((source, target, recurrent), known)
                ledger.next_innovation = max(ledger.next_innovation, innovation + 1)
            ledger.next_node_id = max(ledger.next_node_id, int(genome.node_id.max()) + 1)
        return ledger

    def number_apart(self, part: int, parts: int) -> None:
        """Give from now on only numbers that leave the remainder `part` when divided by `parts`.

        So do the ledgers of populations that exchange genomes: no number has two meanings. What
        both find has two numbers, as two mutations of two generations have in NEAT.
        """
        self.step = parts
        self.next_innovation += (part - self.next_innovation) % parts
        self.next_node_id += (part - self.next_node_id) % parts

    def link(self, source: int, target: int, recurrent: bool, weight: float) -> LinkInnovation:
        """Return number and weight for a new link; `weight` counts only if it is the first."""
        key = (int(source), int(target), bool(recurrent))
        if key not in self._links:
            self._links[key] = LinkInnovation(self.next_innovation, float(weight))
            self.next_innovation += self.step
        return self._links[key]

    def split(self, link_innovation: int, taken_node_ids: Collection[int]) -> Split:
        """Return the split of a link: the same for everyone, unless its node is taken.

        A link that was enabled again can be split twice in one genome; the second split is
        then shared with all genomes to which the same happens.
        """
        splits = self._splits.setdefault(int(link_innovation), [])
        for split in splits:
            if split.node_id not in taken_node_ids:
                return split
        split = Split(self.next_node_id, self.next_innovation, self.next_innovation + self.step)
        self.next_node_id += self.step
        self.next_innovation += 2 * self.step
        splits.append(split)
        return split

    def forget(self) -> None:
        """Forget all mutations, but no number: the same ones get new numbers from now on."""
        self._links.clear()
        self._splits.clear()

    def state_dict(self) -> dict[str, Any]:
        """Return the ledger as JSON values."""
        return {
            "next_innovation": self.next_innovation,
            "next_node_id": self.next_node_id,
            "step": self.step,
            "links": [[*key, *known] for key, known in self._links.items()],
            "splits": [[link, *split] for link, splits in self._splits.items() for split in splits],
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Self:
        """Return the ledger that `state_dict` described."""
        step = state.get("step", 1)  # before there were islands none was saved
        ledger = cls(state["next_innovation"], state["next_node_id"], step)
        for source, target, recurrent, innovation, weight in state["links"]:
            ledger._links[source, target, recurrent] = LinkInnovation(innovation, weight)
        for link, *split in state["splits"]:
            ledger._splits.setdefault(link, []).append(Split(*split))
        return ledger
