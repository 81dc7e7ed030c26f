"""The command line as a manual page and as completion of bash, both from the help of the commands.

`deploy/bundle` runs `python -m service.commands.manual page` and `... completion`. The completion is a table, not a
call of the program, which would import for seconds at each press of the key.
"""

import sys
from collections.abc import Iterator
from importlib import metadata
from typing import Any

import typer

from service.commands.cli import COMMANDS, build_app

FILES = (
    ("/etc/stonefall/stonefall.toml", "Configuration of the daemon; stonefall check-config explains it."),
    ("/var/lib/stonefall", "Results, calibrations, keys, backups."),
    ("/opt/stonefall/current", "The release that is used, with its guides (README.md)."),
)
STATUS = (
    ("0", "Done."),
    ("1", "Failed; one line on standard error says why."),
    ("2", "Wrong usage."),
)


def commands() -> Iterator[tuple[str, Any, Any]]:
    """Yield each command of the command line, groups before theirs: its words, itself, and a context for its help."""
    app = build_app(name for name, module in COMMANDS.items() if not module.startswith("research"))
    pending = [("stonefall", typer.main.get_command(app))]
    while pending:
        words, command = pending.pop(0)
        yield words, command, command.make_context(words, [], resilient_parsing=True)
        pending[:0] = [(f"{words} {name}", each) for name, each in getattr(command, "commands", {}).items()]


def page() -> str:
    """Return the manual page stonefall(1) as roff, man(7)."""
    version = metadata.version("stonefall")
    lines = [f'.TH STONEFALL 1 "" "stonefall {version}" "Stonefall"']
    for words, command, context in commands():
        text = [paragraph.replace("\n", " ") for paragraph in (command.help or "").split("\n\n")]
        usage = " ".join(command.collect_usage_pieces(context))
        if words == "stonefall":
            lines += [".SH NAME", _roff(f"{words} - {text[0]}"), ".SH SYNOPSIS", _roff(f"{words} {usage}")]
            lines += [".SH COMMANDS"]
        else:
            lines += [f'.SS "{_roff(words)}"', _roff(f"{words} {usage}")]
            for paragraph in text:
                lines += [".PP", _roff(paragraph)]
        for parameter in command.get_params(context):
            record = parameter.get_help_record(context)
            if record is not None and "--help" not in parameter.opts:
                lines += _entry(record[0], " ".join(record[1].split()))
    for title, entries in (("FILES", FILES), ("EXIT STATUS", STATUS)):
        lines += [f".SH {title}", *(line for entry in entries for line in _entry(*entry))]
    return "\n".join(lines) + "\n"


def completion() -> str:
    """Return the completion of bash: the words that may follow each command, and files."""
    cases = []
    for words, command, context in commands():
        options = [
            word for each in command.get_params(context) for word in [*each.opts, *each.secondary_opts]
        ]
        following = [*getattr(command, "commands", {}), *(word for word in options if word.startswith("--"))]
        cases.append(f'        "{words}") words="{" ".join(following)}" ;;')
    names = "|".join(f'"{words}"' for words, command, _ in commands() if hasattr(command, "commands"))
    return COMPLETION.format(groups=names, cases="\n".join(cases))


COMPLETION = """\
# Completion of stonefall(1) for bash, made by service/commands/manual.py.
_stonefall() {{
    local command=stonefall words="" index
    for ((index = 1; index < COMP_CWORD; index++)); do
        case $command in
        {groups}) [[ ${{COMP_WORDS[index]}} == -* ]] || command+=" ${{COMP_WORDS[index]}}" ;;
        *) break ;;
        esac
    done
    case $command in
{cases}
    esac
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}")
}}
complete -o bashdefault -o default -F _stonefall stonefall
"""


def _entry(term: str, text: str) -> list[str]:
    return [".TP", f".B {_roff(term)}", _roff(text)]


def _roff(text: str) -> str:
    """Return a line of text that roff prints as it is."""
    plain = text.replace("\\", "\\e").replace("-", "\\-")
    return plain if plain and plain[0] not in ".'" else f"\\&{plain}"


if __name__ == "__main__":
    sys.stdout.write({"page": page, "completion": completion}[sys.argv[1]]())
