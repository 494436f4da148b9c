"""The random seeds of a run: three days take all of them, and each day every kind."""

import os
from datetime import date

import pytest

from helpers.seeds import ALL, CHOICES, VARIABLE, choose_seeds, examples, seeds, turn, whole_sample

THIRDS = CHOICES[:3]


def taken(monkeypatch, choice, *given):
    monkeypatch.setenv(VARIABLE, choice)
    return seeds(*given)


@pytest.mark.parametrize("count", [3, 4, 10, 60])
def test_three_days_take_every_seed_once(monkeypatch, count):
    thirds = [taken(monkeypatch, choice, range(count)) for choice in THIRDS]
    assert (
        sorted(one for third in thirds for one in third) == taken(monkeypatch, ALL, range(count)) == list(range(count))
    )
    assert min(map(len, thirds)) >= 1


@pytest.mark.parametrize("kinds", [2, 3, 4])
def test_a_third_has_all_kinds(monkeypatch, kinds):
    """Random problems often have the kind seed % kinds."""
    for choice in THIRDS:
        assert {seed % kinds for seed in taken(monkeypatch, choice, range(36))} == set(range(kinds))


@pytest.mark.parametrize("choice", CHOICES)
def test_seeds_with_a_wrong_answer_once_run_every_day(monkeypatch, choice):
    assert taken(monkeypatch, choice, range(3), (474, 595))[-2:] == [474, 595]


def test_the_day_chooses_unless_the_environment_has_a_choice(monkeypatch):
    monkeypatch.setattr("helpers.seeds.today", lambda: date(2026, 1, 1))
    monkeypatch.delenv(VARIABLE)
    choose_seeds()
    first = seeds(range(9))
    monkeypatch.setattr("helpers.seeds.today", lambda: date(2026, 1, 2))
    choose_seeds()
    assert seeds(range(9)) == first  # a worker, after midnight
    monkeypatch.delenv(VARIABLE)
    choose_seeds()
    assert not set(seeds(range(9))) & set(first)
    monkeypatch.setenv(VARIABLE, "3")
    with pytest.raises(pytest.UsageError, match="got '3'; expected one of 0, 1, 2, all"):
        choose_seeds()


def test_examples_are_a_third_and_at_least_one(monkeypatch):
    monkeypatch.setenv(VARIABLE, "0")
    assert (examples(60), examples(2)) == (20, 1)
    monkeypatch.setenv(VARIABLE, ALL)
    assert examples(60) == 60


@pytest.mark.parametrize(("mark", "runs"), [(turn(1), ["1", ALL]), (turn(2), ["2", ALL]), (whole_sample, [ALL])])
def test_an_expensive_test_has_its_day_and_runs_with_all_seeds(monkeypatch, mark, runs):
    (condition,) = mark.args
    for choice in CHOICES:
        monkeypatch.setenv(VARIABLE, choice)
        assert eval(condition, {"os": os}) == (choice not in runs)
