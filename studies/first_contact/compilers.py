"""Compilers that do not write what they are asked for, as lines of a shell whose arguments are the compiler's."""

_PLACE = 'cc "$@"; while [ "$1" != -o ]; do shift; done; size=$(wc -c <"$2"); '
WRONG = {f"{tenth} tenths": f'{_PLACE} truncate -s $((size * {tenth} / 10)) "$2"' for tenth in range(10)} | {
    "one byte less": f'{_PLACE} truncate -s $((size - 1)) "$2"', "text": f'{_PLACE} echo library >"$2"',
    "nothing": f'{_PLACE} rm "$2"', "a directory": f'{_PLACE} rm "$2"; mkdir "$2"',
    "a header, then garbage": f'{_PLACE} head -c 64 "$2" >part; yes | head -c $size >>part; mv part "$2"',
    "a header, then zeros": f'{_PLACE} truncate -s 64 "$2"; truncate -s $size "$2"',
    "another library": 'while [ "$1" != -o ]; do shift; done; echo "int x;" | cc -shared -x c - -o "$2"'}


def script(line: str) -> str:
    """A compiler that introduces itself as any other, and compiles as a line of a shell says."""
    return f'#!/bin/sh\ncase "$*" in *-dM*) exec cc "$@";; esac\n{line}\n'
