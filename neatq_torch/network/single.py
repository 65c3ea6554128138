"""One genome as an ordinary PyTorch module."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from neatq_torch.genome.genome import Genome
from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import PopulationNetwork


class GenomeNetwork(nn.Module):
    """The network of one genome: a drop-in module, `[..., inputs] -> [..., outputs]`.

    It is a `PopulationNetwork` of one, so it trains, moves between devices, copies, saves
    (`state_dict`) and exports (`torch.export`) like any other module.

    Args:
        genome: The genome to compile.
        evaluation: `settle` or `synchronous`, see `PopulationNetwork`.

    Example:
        >>> network = GenomeNetwork(load_genome("champion.json"))
        >>> outputs = network(torch.rand(32, network.inputs))
    """

    def __init__(self, genome: Genome, *, evaluation: Evaluation = "settle") -> None:
        super().__init__()
        self.network = PopulationNetwork([genome], evaluation=evaluation)
        # Whoever traces (torch.compile, a strict torch.export) must find it made.
        self.network.plan.levels(self.network.weight.device)

    @property
    def inputs(self) -> int:
        """Observations, without the bias."""
        return self.network.inputs

    @property
    def outputs(self) -> int:
        """Outputs."""
        return self.network.outputs

    @property
    def state_size(self) -> int:
        """Values kept from one call to the next; 0 without recurrent links."""
        return self.network.state_size

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state before the first call: zeros [*batch, state_size]."""
        return self.network.initial_state(batch)[0]

    def forward(self, observation: Tensor) -> Tensor:
        """Outputs [..., outputs] for observations [..., inputs], from the initial state."""
        return self.network(observation.unsqueeze(0)).squeeze(0)

    def step(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One call of a recurrent network.

        Args:
            observation: [..., inputs].
            state: [..., state_size].

        Returns:
            Outputs [..., outputs] and the state for the next call [..., state_size].
        """
        output, state = self.network.step(observation.unsqueeze(0), state.unsqueeze(0))
        return output.squeeze(0), state.squeeze(0)

    def genome(self) -> Genome:
        """The genome with the weights that the network has now, bit for bit."""
        return self.network.genome(0)
