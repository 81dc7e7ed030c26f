"""The manual page and the completion of bash have all commands and options, and nothing that roff or bash misreads."""

import re
import subprocess
from pathlib import Path

import pytest

from service.commands import manual

MACROS = {".TH", ".SH", ".SS", ".PP", ".TP", ".B"}


def test_the_page_has_every_command_with_its_options() -> None:
    page = manual.page()
    for words, command, context in manual.commands():
        title = f'.SS "{words}"'.replace("-", "\\-") if words != "stonefall" else ".SH COMMANDS"
        section = page.partition(f"{title}\n")[2].partition("\n.SS ")[0]
        assert section, words
        for parameter in command.get_params(context):
            name = parameter.opts[0]
            if name.startswith("-") and not parameter.hidden and name != "--help":
                assert name.replace("-", "\\-") in section, (words, name)


def test_every_line_of_the_page_is_text_or_a_macro_that_roff_knows() -> None:
    lines = manual.page().splitlines()
    assert {line.split()[0] for line in lines if line.startswith((".", "'"))} <= MACROS
    assert all(lines)
    assert not [line for line in lines if re.search(r"\\(?![-e&])", line)]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("stonefall", "doc"), {"doctor"}),
        (("stonefall", "lots", "op"), {"open"}),
        (("stonefall", "keys", "create", "--sc"), {"--scope"}),
        (("stonefall", "measure", "--out", "x", "--sav"), {"--save-silhouettes"}),
        (("stonefall", "serve", "/et"), set()),
    ],
)
def test_bash_completes_commands_and_options(
    tmp_path: Path, words: tuple[str, ...], expected: set[str]
) -> None:
    script = tmp_path / "completion"
    script.write_text(manual.completion())
    run = 'source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _stonefall; echo "${COMPREPLY[@]}"'
    done = subprocess.run(
        ["bash", "-euc", run, "-", script, *words], capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == expected
