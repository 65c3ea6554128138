"""When the flag was found, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_experiments.compare.cells import CONTACT, champion_reaches, first_contact, stable_contact


def rows(near: str) -> tuple[np.ndarray, np.ndarray]:
    """Ticks and distances of rows; x is in contact, anything else is not."""
    distance = np.array([CONTACT if one == "x" else CONTACT + 0.1 for one in near])
    return 100 * np.arange(1, len(near) + 1), distance


def test_first_contact_is_the_tick_of_the_first_row_within_reach() -> None:
    assert first_contact(*rows("..x.x")) == 300
    assert first_contact(*rows(".....")) is None


@pytest.mark.parametrize(
    ("near", "tick"),
    [
        ("xxxxxxxxxx", 100),
        ("..xxxxxxxxxx", 300),
        ("xxxxx.xxxx", 100),  # nine of ten
        ("xxxxx..xxx", None),  # eight of ten, and fewer than ten rows are left after
        ("x....xxxxxxxxx.", 600),  # nine of the ten rows from the sixth
        ("....xxxxxxxxx", None),  # nine rows are less than a life
        ("x" * 20 + "." * 20, None),  # lost again
        ("x.." + "x" * 20, 100),  # 21 of 23
        ("", None),
    ],
)
def test_stable_contact_is_nine_of_ten_rows_to_the_end(near: str, tick: int | None) -> None:
    assert stable_contact(*rows(near)) == tick


def test_the_champion_arrives_if_it_is_there_in_a_tenth_of_the_last_tenth() -> None:
    far = np.full(400, 99.0)
    assert not champion_reaches(far)
    far[:360] = 0.0  # before the last tenth
    far[360:363] = 0.0
    assert not champion_reaches(far)  # 3 of 40
    far[399] = 0.0
    assert champion_reaches(far)
    assert not champion_reaches(np.full(40, np.nan))
