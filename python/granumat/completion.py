"""Completion of the command line in bash and zsh, from the help of the commands."""

import argparse
import re
from collections.abc import Mapping

SHELLS = ("bash", "zsh")

# Options where a word begins with "-", names where the command has a list of them, otherwise files.
SCRIPT = """\
_granumat() {
    local word="${COMP_WORDS[COMP_CWORD]}" options="" names=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        names="COMMANDS"
    else
        case "${COMP_WORDS[1]}" in
CASES
        esac
    fi
    case "$word" in
        -*) names="$options" ;;
    esac
    COMPREPLY=($(compgen -W "$names" -- "$word"))
}
complete -o default -F _granumat granumat
"""
CASE = '            {command}) options="{options}" names="{names}" ;;'
OF_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"


def completion_script(commands: Mapping[str, argparse.ArgumentParser], shell: str) -> str:
    """The script that makes a shell complete the command `granumat`.

    Parameters
    ----------
    commands : dict of str to argparse.ArgumentParser
        Options are found in their help; names to choose from in the default `completes`.
    shell : str
        One of SHELLS.

    Returns
    -------
    str
    """
    cases = []
    for name, command in commands.items():
        options = dict.fromkeys(re.findall(r"(?<![\w-])--?[a-z][\w-]*", command.format_help()))
        cases.append(CASE.format(command=name, options=" ".join(options), names=" ".join(command.get_default("completes") or ())))
    script = SCRIPT.replace("COMMANDS", " ".join(commands)).replace("CASES", "\n".join(cases))
    return (OF_ZSH if shell == "zsh" else "") + script
