"""Rankings and figures of matches, against what was worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from scipy.optimize import minimize

from neatq_torch.kinds import ConfigError
from neatq_trainers.nero.figures import draw_duel, draw_matrix, short_names
from neatq_trainers.nero.match_table import MatchRow
from neatq_trainers.nero.ranking import (
    ELO_POINTS,
    Agreement,
    Standing,
    agreement,
    ranking_csv,
    standings,
    standings_text,
    strengths,
    wilson,
    wins_over,
)


def match(blue: str, red: str, damage: tuple[int, int], seed: int = 0) -> MatchRow:
    winner = "draw" if damage[0] == damage[1] else "blue" if damage[0] < damage[1] else "red"
    return MatchRow(blue, red, seed, *damage, 100, winner)


CYCLE = [
    match("a", "b", (10, 50)),
    match("b", "a", (60, 20)),
    match("b", "c", (0, 10)),
    match("c", "b", (30, 30)),
    match("c", "a", (0, 100)),
    match("a", "c", (40, 30)),
]
"""a beats b twice, b beats c and draws, c beats a twice."""


def test_matches_are_counted_and_scores_are_means() -> None:
    a, b, c = (next(one for one in standings(CYCLE) if one.team == name) for name in "abc")
    assert a[:6] == ("a", 4, 2, 0, 2, 0.5)
    assert b[:6] == ("b", 4, 1, 1, 2, 0.25)
    assert c[:6] == ("c", 4, 2, 1, 1, 0.5)
    assert [one.score for one in (a, b, c)] == [(40 + 40 - 100 - 10) / 4, (-80 + 10) / 4, 25]
    assert [one.team for one in standings(CYCLE)] == ["c", "a", "b"]  # the share, then the score


def test_a_share_has_the_interval_of_wilson() -> None:
    wins, matches, z = 3, 20, 1.959964
    share, spread = wins / matches, z * z / matches
    middle = (share + spread / 2) / (1 + spread)
    half = z * math.sqrt(share * (1 - share) / matches + spread / matches / 4) / (1 + spread)
    assert wilson(wins, matches) == pytest.approx((middle - half, middle + half), abs=1e-6)
    found = standings([match("a", "b", (5, 9), seed) for seed in range(4)])
    assert (found[0].share_low, found[0].share_high) == wilson(4, 4)


def test_the_interval_of_a_mean_score_is_over_pairs_of_return_matches() -> None:
    # Seed 0: +200 as blue and -200 as red; seed 1: +60 and +40. The pairs' means are 0 and 50,
    # so means of two draws are 0, 25 or 50, a quarter, a half and a quarter of the time.
    damage = [((0, 200), 0, 1), ((0, 200), 0, -1), ((0, 60), 1, 1), ((40, 0), 1, -1)]
    rows = [match("ab"[::turn][0], "ab"[::turn][1], taken, seed) for taken, seed, turn in damage]
    found = next(one for one in standings(rows) if one.team == "a")
    assert (found.score, found.score_low, found.score_high) == (25, 0, 50)


def test_a_single_pair_has_no_interval() -> None:
    found = standings([match("a", "b", (0, 5)), match("b", "a", (9, 0))])[0]
    assert found.score == 7 and math.isnan(found.score_low) and math.isnan(found.score_high)
    assert "  +7  " in standings_text([found])
    assert ranking_csv([found]).splitlines()[1].startswith("a,2,2,0,0,1,0.34238,1,7,,,")


def test_the_strengths_of_two_teams_are_their_log_odds() -> None:
    # 15 wins to 5, and half a win for each more: odds of 15.5 to 5.5.
    strength, error = strengths(np.array([[0.0, 15], [5, 0]]))
    odds = math.log(15.5 / 5.5)
    assert strength == pytest.approx([odds / 2, -odds / 2], abs=1e-7)
    chance = 15.5 / 21
    assert error == pytest.approx([math.sqrt(1 / (21 * chance * (1 - chance))) / 2] * 2)
    rows = [match("a", "b", (0, 1) if seed < 15 else (1, 0), seed) for seed in range(20)]
    best = standings(rows)[0]
    assert best.elo == pytest.approx(400 * math.log10(15.5 / 5.5) / 2, abs=1e-4)
    assert best.elo_high - best.elo == pytest.approx(1.959964 * ELO_POINTS * error[0])


def test_strengths_are_those_of_greatest_likelihood() -> None:
    wins = np.random.default_rng(0).integers(0, 9, (5, 5)) * (1 - np.eye(5))
    wins[0, 1:], wins[1:, 0] = 9, 0  # one always wins

    def unlikely(strength: np.ndarray) -> float:
        apart = strength[:, None] - strength[None]
        more = (1 - np.eye(5)) / 8
        return float(((wins + more) * np.logaddexp(0, -apart)).sum() + strength.sum() ** 2)

    plain = minimize(unlikely, np.zeros(5), tol=1e-10).x
    strength, _ = strengths(wins)
    assert strength == pytest.approx(plain, abs=1e-4)
    assert strength.sum() == pytest.approx(0, abs=1e-9)


def test_in_a_circle_all_are_equally_strong_and_a_draw_is_half_a_win() -> None:
    circle = wins_over(CYCLE, "abc")
    assert circle.tolist() == [[0, 2, 0], [0, 0, 1.5], [2, 0.5, 0]]
    circle[1:, 1:] = [[0, 2], [0, 0]]
    strength, error = strengths(circle)
    assert strength == pytest.approx(np.zeros(3), abs=1e-9)
    assert error == pytest.approx(np.full(3, error[0]))


def test_who_always_wins_has_a_strength_and_an_interval() -> None:
    best, worst = standings([match("a", "b", (0, 100), seed) for seed in range(50)])
    assert best.elo == pytest.approx(-worst.elo) == pytest.approx(200 * math.log10(101), abs=1e-3)
    assert best.elo_low > worst.elo_high


def test_a_ranking_is_compared_with_a_published_one(tmp_path: Path) -> None:
    path = tmp_path / "p.tsv"
    lines = ["file\tmore\twins_of_155_as_blue\tmean_score", "a\tx\t9\t-3", "b\tx\t7\t5"]
    lines += ["c\tx\t8\t4", "d\tx\t1\t6", "z\tx\t99\t99"]
    path.write_text("\n".join(lines) + "\n")
    blank = Standing("", 1, *[0] * 12)
    ranking = [
        blank._replace(team=name, share=share, score=score)
        for name, share, score in (("a", 0.9, 40), ("b", 0.8, 30), ("c", 0.7, 20), ("d", 0.1, 10))
    ]
    # Ranks of wins 1 2 3 4 and 1 3 2 4: squares of differences sum to 2, 1 - 6 * 2 / 60.
    # Ranks of scores 1 2 3 4 and 4 2 3 1: they sum to 18, 1 - 6 * 18 / 60.
    assert agreement(ranking, path) == pytest.approx(Agreement(4, 0.8, -0.8))
    equal = agreement([one._replace(share=0.5) for one in ranking], path)
    assert math.isnan(equal.wins) and equal.scores == pytest.approx(-0.8)
    with pytest.raises(ConfigError, match=r"at least three of the teams that play.* got a, b"):
        agreement(ranking[:2], path)


@pytest.mark.parametrize(
    "text", ["", "file\twins\n", "file\twins\tmean_score\na\tmany\t1\n", "\xff"]
)
def test_a_published_table_must_have_its_columns(tmp_path: Path, text: str) -> None:
    (tmp_path / "p.tsv").write_text(text, "latin-1")
    with pytest.raises(ConfigError, match="expected a table with tabs and the columns file, wins"):
        agreement(standings(CYCLE), tmp_path / "p.tsv")


def test_a_printed_ranking_stops_where_it_is_told() -> None:
    lines = standings_text(standings(CYCLE), most=2).splitlines()
    assert lines[0].split() == [
        *("team", "matches", "won", "drawn", "lost", "share", "won", "mean", "score", "Elo")
    ]
    assert [line.split()[:6] for line in lines[1:3]] == [
        ["1", "c", "4", "2", "1", "1"],
        ["2", "a", "4", "2", "0", "2"],
    ]
    assert lines[3:] == ["... and 1 more in ranking.csv"]
    assert "-0" not in standings_text([standings(CYCLE)[0]._replace(elo=-0.3)])


def test_the_matrix_is_sorted_by_mean_score_and_has_blue_in_rows() -> None:
    axes, bar = draw_matrix(CYCLE).axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == [label.get_text() for label in axes.get_xticklabels()] == ["c", "a", "b"]
    cells = axes.images[0].get_array()
    assert cells is not None
    means = [[math.nan, 100, 0], [-10, math.nan, 40], [10, -40, math.nan]]
    np.testing.assert_array_equal(np.ma.filled(cells, np.nan), means)
    assert axes.images[0].get_clim() == (-100, 100)
    red, _, blue, _ = axes.images[0].cmap(0.9)
    assert blue > red and bar.get_title() == "blue wins"
    assert [text.get_text() for text in axes.texts] == ["+100", "+0", "-10", "+40", "+10", "-40"]


def test_many_teams_have_no_numbers_in_their_cells() -> None:
    names = [f"t{number}" for number in range(13)]
    rows = [match(blue, red, (1, 2)) for blue in names for red in names if blue != red]
    assert not draw_matrix(rows).axes[0].texts


def test_a_duel_shows_what_both_took_in_each_match() -> None:
    rows = [match("a", "b", (10, 50)), match("b", "a", (60, 20)), match("a", "b", (70, 5), 1)]
    damage, wins = draw_duel(rows).axes
    first, second = (np.array(line.get_xydata()).tolist() for line in damage.lines)
    assert (first, second) == ([[10, 50], [70, 5]], [[20, 60]])
    shares = [line.get_xdata() for line in wins.lines if line.get_marker() == "o"]
    assert np.array(shares).ravel().tolist() == pytest.approx([2 / 3, 1 / 2, 1])
    counts = [text.get_text() for text in wins.texts]
    assert counts == ["2 won, 1 lost", "1 won, 1 lost", "1 won, 0 lost"]
    alone = draw_duel(rows[:1]).axes[1]
    assert [text.get_text() for text in alone.texts][-1] == "no match"


def test_figures_take_names_as_they_are() -> None:
    rows = [match("$a_$.gz", "b^{.gz", (10, 50)), match("b^{.gz", "$a_$.gz", (60, 20))]
    for figure in (draw_matrix(rows), draw_duel(rows)):
        figure.draw_without_rendering()  # a formula would raise an error
        texts = [text.get_text() for text in figure.findobj(Text)]  # type: ignore[arg-type]
        assert any("$a_$" in text for text in texts)


def test_short_names_still_differ() -> None:
    assert short_names(["a.txt.gz", "b.pop.gz", ".gz"]) == ["a", "b.pop", ".gz"]
    assert short_names(["a.txt.gz", "a.txt", "a.pop"]) == ["a.txt.gz", "a.txt", "a.pop"]
    assert short_names(["x" * 40, "y"]) == ["x" * 29 + "…", "y"]
