"""The reference of all commands, from the command line itself: what ``--help`` says, as tables."""

from __future__ import annotations

import re
from typing import Any

import typer

from extension.text import cell
from hydroopt.cli import app

OPTION = re.compile(r"(?<![\w`-])--?[a-z][\w-]*(?=[\s,;.)]|$)")
"""An option within a sentence, which is no dash."""
HEAD = """# Commands

One job a command. `hydroopt COMMAND --help` says the same. MACHINE is a bundled name, a `.toml`, `.urdf` or `.xml`
(MJCF) file. `-o DIR` receives everything, written whole or not at all.

| exit code | meaning |
|---|---|
| 0 | success |
| 2 | bad input: one sentence with place and remedy |
| 3 | no trustworthy answer; nothing is exported without `--force` |

| command | does |
|---|---|
"""


def pages() -> dict[str, str]:
    """Text of the page by its path below ``docs/generated``."""
    root = typer.main.get_command(app)
    context = root.make_context("hydroopt", [], resilient_parsing=True)
    rows, sections = [], []
    for name in root.list_commands(context):
        command = root.get_command(context, name)
        own = command.make_context(name, [], parent=context, resilient_parsing=True)
        rows.append(f"| [`{name}`](#{name}) | {cell(command.get_short_help_str(1000))} |")
        sections.append(_section(name, own))
    return {"commands.md": HEAD + "\n".join(rows) + "\n\n" + "\n".join(sections)}


def _section(name: str, context: Any) -> str:
    command = context.command
    if hasattr(command, "list_commands"):
        made = [f"## {name}\n\n{command.help or ''}\n"]
        for each in command.list_commands(context):
            below = command.get_command(context, each).make_context(each, [], parent=context, resilient_parsing=True)
            made.append(_section(f"{name} {each}", below).replace("## ", "### ", 1))
        return "\n".join(made)
    text, _, example = (command.help or "").partition("Example: ")
    usage = " ".join(command.collect_usage_pieces(context))
    lines = [f"## {name}", "", text, "", "```text", f"hydroopt {name} {usage}", "```", ""]
    if example:
        lines += ["For example:", "", "```sh", " ".join(example.split()), "```", ""]
    records = [(parameter, parameter.get_help_record(context)) for parameter in command.params]
    said = [(record[0].strip().replace("|", "\\|"), cell(OPTION.sub(r"`\g<0>`", record[1])))
            for _, record in records if record]
    rows = [f"| `{argument}` | {meaning} |" for argument, meaning in said]
    lines += ["| argument or option | meaning |", "|---|---|", *rows, ""]
    return "\n".join(lines)
