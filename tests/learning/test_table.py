"""OpenNERO's Q-tables, by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_torch.learning.table import TableConfig, TableLearner


def table(robots: int = 1, config: TableConfig | None = None) -> TableLearner:
    return TableLearner((1, robots), [-1.0, 0.0], [1.0, 1.0], config or TableConfig(), [0])


def transition(now: float, following: float, action: list[float], reward: float) -> TensorDict:
    next_ = {"observation": torch.full((1, 1, 1, 2), following)}
    next_["reward"] = torch.full((1, 1, 1, 1), reward)
    next_["terminated"] = torch.zeros(1, 1, 1, 1, dtype=torch.bool)
    observation = torch.full((1, 1, 1, 2), now)
    action_ = torch.tensor(action).view(1, 1, 1, 2)
    values = {"observation": observation, "action": action_, "next": next_}
    return TensorDict(values, (1, 1, 1))


def test_sensors_fall_into_five_bins_and_robots_have_tables_of_their_own() -> None:
    q = table(robots=2)
    same = q.rows(np.array([[[0.0, 0.12], [0.0, 0.12]]]))
    other = q.rows(np.array([[[0.1, 0.0], [0.13, 0.0]]]))
    assert same[0] != same[1]
    assert other[0] == same[0]
    assert other[1] not in same


def test_actions_are_the_three_levels_of_each_dimension() -> None:
    q = table()
    assert q.actions.tolist() == [[a, b] for a in (-1, 0, 1) for b in (0, 0.5, 1)]
    assert q.index(np.array([0.4, 0.8])) == 3 * 1 + 2
    assert q.index(np.array([-0.6, 0.2])) == 0


def test_two_updates_by_hand() -> None:
    q = table(config=TableConfig(learning_rate=0.5, discount=0.5))
    # The first reward is used with the second action: 0.5 * (0 + 0.5 * 0 - 0) = 0.
    assert q.update(transition(0.0, 1.0, [1.0, 1.0], 0.6)).item() == 0.0
    # Then 0.6 - 1 = -0.4: Q = 0.5 * (-0.4 + 0.5 * 0 - 0) = -0.2.
    assert q.update(transition(1.0, 0.0, [0.0, 0.5], 0.9)).item() == pytest.approx(0.16)
    row = q.rows(np.array([[[1.0, 1.0]]]))[0]
    assert q.values[row].tolist() == pytest.approx([0, 0, 0, 0, -0.2, 0, 0, 0, 0])


def test_the_greedy_action_is_the_best_one_and_exploration_is_anywhere_in_the_bounds() -> None:
    q = table(config=TableConfig(epsilon=1.0))
    rows = TensorDict({"observation": torch.zeros(1, 1, 2)}, (1, 1))
    row = q.rows(np.zeros((1, 1, 2)))[0]
    q.values[row] = -1.0
    q.values[row, 5] = -0.5
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert q.policy(rows)["action"].tolist() == [[[0.0, 1.0]]]
    drawn = torch.stack([q.policy(rows)["action"][0, 0] for _ in range(200)])
    assert drawn[:, 0].min() < -0.9 and drawn[:, 0].max() > 0.9
    assert drawn[:, 1].min() >= 0.0 and len(drawn.unique(dim=0)) == 200


def test_tables_grow_and_come_back_from_their_state() -> None:
    q = TableLearner((1, 1), [0.0], [1.0], TableConfig(), [0])
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 5), -1).reshape(-1, 1, 1, 5)
    rows = np.concatenate([q.rows(observation) for observation in grid])
    assert len(set(rows.tolist())) == 5**5 <= len(q.values)
    q.values[rows] = rows[:, None]
    again = TableLearner((1, 1), [0.0], [1.0], TableConfig(), [0])
    again.load_state_dict(q.state_dict())
    found = np.concatenate([again.rows(observation) for observation in grid])
    assert (again.values[found, 0] == rows).all()


def test_an_actor_goes_on_with_its_own_chance() -> None:
    seen = TensorDict({"observation": torch.zeros(1, 1, 2)}, (1, 1))
    one, other = table(), table()
    for _ in range(3):
        one.policy(seen)
    other.policy.load_state_dict(one.policy.state_dict())
    again = [actor.policy(seen.clone())["action"].tolist() for actor in (one, other)]
    assert again[0] == again[1] != table().policy(seen.clone())["action"].tolist()
