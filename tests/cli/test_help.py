"""Help texts and shell completion: option groups, examples that parse, and completed values.

Tests internals: `resgrid.cli`, `resgrid.cli.entry`.
"""

from __future__ import annotations

import shlex

import click
import pytest
from click.shell_completion import ShellComplete

from resgrid.cli import main
from resgrid.cli.entry import SUBCOMMANDS

COMMANDS = {subcommand: main.get_command(click.Context(main), subcommand) for subcommand in SUBCOMMANDS}
SCENE_SUBCOMMANDS = [subcommand for subcommand in SUBCOMMANDS if subcommand != "completion"]
SHARED = {
    "--boundary", "--drive", "--edge", "--resistance", "--goal", "--start", "--cells", "--robot-radius", "--k", "--set",
    "--threads", "--json", "--quiet", "--verbose",
}  # fmt: skip


@pytest.mark.parametrize("subcommand", SCENE_SUBCOMMANDS)
def test_subcommands_with_a_scene_have_the_shared_options(subcommand):
    assert {name for parameter in COMMANDS[subcommand].params for name in parameter.opts} >= SHARED


@pytest.mark.parametrize("subcommand", SCENE_SUBCOMMANDS)
def test_help_lists_groups_of_options_with_specific_ones_first(call, subcommand):
    text = call(subcommand, "--help").stdout
    titles = "Options:", "Output:", "Scene keys:", "Map options:", "Deck options:"
    places = [text.index(f"\n{title}\n") for title in titles if f"\n{title}\n" in text]
    assert places == sorted(places) and len(places) >= 4
    assert ("Deck options:" in text) == ("DECK" in text.splitlines()[0])
    assert text.index("Output:") < text.index("--json") < text.index("--boundary") < text.index("--format")
    for parameter in COMMANDS[subcommand].params:
        assert not isinstance(parameter, click.Option) or parameter.opts[-1] in text


@pytest.mark.parametrize("subcommand", SUBCOMMANDS)
def test_examples_in_help_are_valid_command_lines(subcommand):
    command = COMMANDS[subcommand]
    assert command.examples and SUBCOMMANDS[subcommand]
    for example in command.examples:
        words = shlex.split(example.replace('eval "$(', "").replace(')"', "").split(" | ")[0])
        assert words[:2] == ["resgrid", subcommand]
        command.make_context(subcommand, words[2:])


@pytest.mark.parametrize(
    ("words", "begin", "expected"),
    [
        (["path", "--boundary"], "", {"dirichlet", "neumann", "wall"}),
        (["compile", "--dialect"], "x", {"xyce"}),
        (["control", "--settle"], "", {"chip", "jacobi", "sor"}),
        (["plot", "--what"], "s", {"space", "slices"}),
        (["info", "--unknown"], "f", {"free"}),
        (["path", "--set"], "ch", {"chip."}),
        (["path", "--set"], "chip.defects.short", {"chip.defects.short_density=", "chip.defects.short_resistance="}),
        (["path", "--set"], "chips.", set()),
        (["chip", "--executor"], "p", {"processes", "parsl:"}),
        (["completion"], "", {"bash", "zsh", "fish"}),
        ([], "con", {"convert", "control"}),
    ],
)
def test_option_values_are_completed(words, begin, expected):
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    assert {item.value for item in completion.get_completions(words, begin)} == expected


def test_file_names_are_completed_by_the_shell():
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    for words in (["run"], ["path", "-o"], ["check", "--deck"]):
        assert [item.type for item in completion.get_completions(words, "map")] == ["file"]


def test_names_of_example_scenes_are_completed_together_with_files(tmp_path, monkeypatch):
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    monkeypatch.chdir(tmp_path)

    def completed(begin):
        return [item.value for item in completion.get_completions(["run"], begin)]

    assert completed("ro") == ["rooms"]
    assert {"lesson", "rooms", "voxels"} <= set(completed(""))
    (tmp_path / "robots").mkdir()
    (tmp_path / "room.toml").touch()
    assert completed("ro") == ["robots/", "room.toml", "rooms"]
    assert [item.type for item in completion.get_completions(["run"], "")] == ["file"]


@pytest.mark.parametrize("words", [("lesson.toml", "--k", "0.5"), ("rooms",), ("deck.cir",)])
def test_a_scene_without_a_subcommand_proposes_resgrid_run(call, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = call(*words)
    assert result.exit_code == 2
    assert f"resgrid run {shlex.join(words)}" in result.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_the_script_for_a_shell(call, shell):
    result = call("completion", shell)
    assert result.exit_code == 0 and "_RESGRID_COMPLETE" in result.stdout and "resgrid" in result.stdout
    assert call("completion", "tcsh").exit_code == 2
