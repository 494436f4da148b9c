"""What a shell offers when a command is half written."""

from __future__ import annotations

import io
from contextlib import redirect_stdout

import pytest
from click.shell_completion import BashComplete

import lin_freq_ocp as lfo
from lin_freq_ocp import cli

VARIABLE = "_LIN_FREQ_OCP_COMPLETE"


def offered(words, incomplete):
    return BashComplete(cli.cli, {}, "lin-freq-ocp", VARIABLE).get_completions(list(words), incomplete)


@pytest.mark.parametrize("command", ["solve", "compare", "sweep", "certify", "show"])
def test_problems_are_offered_by_name_and_files_beside_them(command):
    found = offered([command], "pend")
    assert [one.value for one in found if one.type == "plain"] == [
        "pendulum",
        "pendulum_with_wall",
        "pendulum_swing_up",
    ]
    assert [one.type for one in found if one.type != "plain"] == ["file"]
    assert "inverted pendulum" in found[1].help
    assert len(offered([command], "")) == len(lfo.library.PROBLEMS) + 1


def test_the_script_for_a_shell_is_printed(monkeypatch):
    monkeypatch.setenv(VARIABLE, "zsh_source")
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    with redirect_stdout(stream), pytest.raises(SystemExit) as ended:
        cli.main(())
    script = stream.buffer.getvalue().decode()
    assert not ended.value.code
    assert "compdef" in script
    assert f"{VARIABLE}=zsh_complete lin-freq-ocp" in script
