"""The random seeds of a run: twelve days take all of them, and each day every kind."""

import os
from datetime import date

import pytest

from helpers.seeds import ALL, PARTS, VARIABLE, choose_seeds, examples, has_its_turn, seeds, whole_sample

DAYS = [str(one) for one in range(PARTS)]


def taken(monkeypatch, choice, *given):
    monkeypatch.setenv(VARIABLE, choice)
    return seeds(*given)


@pytest.mark.parametrize("count", [1, 2, 5, 12, 13, 60])
def test_twelve_days_take_every_seed_and_each_day_takes_one(monkeypatch, count):
    days = [taken(monkeypatch, choice, range(count)) for choice in DAYS]
    assert {one for day in days for one in day} == set(range(count))
    assert taken(monkeypatch, ALL, range(count)) == list(range(count))
    assert min(map(len, days)) >= 1
    assert max(map(len, days)) <= -(-count // PARTS)


@pytest.mark.parametrize("kinds", [2, 3, 4])
def test_a_part_has_all_kinds(monkeypatch, kinds):
    """Random problems often have the kind seed % kinds."""
    for choice in DAYS:
        assert {seed % kinds for seed in taken(monkeypatch, choice, range(48))} == set(range(kinds))


@pytest.mark.parametrize("choice", [*DAYS, ALL])
def test_seeds_with_a_wrong_answer_once_run_every_day(monkeypatch, choice):
    assert taken(monkeypatch, choice, range(3), (474, 595))[-2:] == [474, 595]


def test_the_day_chooses_unless_the_environment_has_a_choice(monkeypatch):
    monkeypatch.setattr("helpers.seeds.today", lambda: date(2026, 1, 1))
    monkeypatch.delenv(VARIABLE)
    choose_seeds()
    first = seeds(range(36))
    monkeypatch.setattr("helpers.seeds.today", lambda: date(2026, 1, 2))
    choose_seeds()
    assert seeds(range(36)) == first  # a worker, after midnight
    monkeypatch.delenv(VARIABLE)
    choose_seeds()
    assert not set(seeds(range(36))) & set(first)
    monkeypatch.setenv(VARIABLE, "12")
    with pytest.raises(pytest.UsageError, match="got '12'; expected a number from 0 to 11, or all"):
        choose_seeds()


def test_named_files_run_whole(monkeypatch):
    monkeypatch.delenv(VARIABLE)
    choose_seeds(named=True)
    assert seeds(range(36)) == list(range(36))


def test_examples_are_a_twelfth_and_at_least_one(monkeypatch):
    monkeypatch.setenv(VARIABLE, "0")
    assert (examples(60), examples(2)) == (5, 1)
    monkeypatch.setenv(VARIABLE, ALL)
    assert examples(60) == 60


def test_each_expensive_test_has_one_day(monkeypatch):
    days = []
    for choice in DAYS:
        monkeypatch.setenv(VARIABLE, choice)
        days.append({one for one in range(200) if has_its_turn(f"tests/test_a.py::test_b[{one}]")})
    assert sum(map(len, days)) == len(set().union(*days)) == 200
    assert min(map(len, days)) > 5
    monkeypatch.setenv(VARIABLE, ALL)
    assert has_its_turn("tests/test_a.py::test_b[0]")


@pytest.mark.parametrize("choice", [*DAYS, ALL])
def test_the_whole_sample_needs_all_seeds(monkeypatch, choice):
    (condition,) = whole_sample.args
    monkeypatch.setenv(VARIABLE, choice)
    assert eval(condition, {"os": os}) == (choice != ALL)
