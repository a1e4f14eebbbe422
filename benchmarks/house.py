"""Count what a reader of hpcred/ has to hold in mind: modules that name a term of the operator, lines, arguments,
objects that can change, checks written by hand.

    python benchmarks/house.py [folder of hpcred]

A term that is threaded through by hand stands in every module that transforms, writes or checks a model. No test looks
at these numbers; they are for comparing one state of the house with another.
"""

import ast
import sys
import tokenize
from collections import Counter
from pathlib import Path

TERMS = ("viscoelastic", "derivatives", "circulatory")
MANY = 12  # arguments from which a signature is listed


def main(house):
    texts = {path: path.read_text() for path in sorted(house.rglob("*.py"))}
    print(f"{len(texts)} modules, {sum(text.count(chr(10)) for text in texts.values())} lines, "
          f"{sum(comments_of(path) for path in texts)} comments")  # fmt: skip
    rooms = Counter()
    for path, text in texts.items():
        rooms[path.relative_to(house).parts[0]] += text.count("\n")
    print("lines by room: " + ", ".join(f"{room} {count}" for room, count in sorted(rooms.items())))
    for term in TERMS:
        named = [path for path, text in texts.items() if term in text]
        lines = sum(term in line for path in named for line in texts[path].splitlines())
        print(f"{term}: {len(named)} modules, {lines} lines")
    nodes = [node for text in texts.values() for node in ast.walk(ast.parse(text))]
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    wide = [(count, node.name) for node in functions if (count := arguments_of(node)) >= MANY]
    print(f"{MANY} arguments or more: " + ", ".join(f"{name} {count}" for count, name in sorted(wide, reverse=True)))
    tables = [text for node in nodes if isinstance(node, ast.ClassDef)
              for text in map(ast.unparse, node.decorator_list) if text.startswith("dataclass")]  # fmt: skip
    print(f"{sum('frozen=True' in text for text in tables)} of {len(tables)} dataclasses are frozen")
    checks = [node for node in functions if node.name == "__post_init__"]
    lines = sum(node.end_lineno - node.lineno + 1 for node in checks)
    print(f"{len(checks)} classes check what they are made of by themselves, in {lines} lines")


def arguments_of(node):
    return len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs)


def comments_of(path):
    with path.open("rb") as file:
        return sum(token.type == tokenize.COMMENT and "fmt:" not in token.string
                   for token in tokenize.tokenize(file.readline))  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / "hpcred"))
