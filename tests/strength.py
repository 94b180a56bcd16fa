"""Mutation test: insert faults into the package one at a time and count those that tests find.

    python -m tests.strength map                 # record which test runs which line (pytest-cov)
    python -m tests.strength run [FOLDER ...]    # insert faults, write build/strength.jsonl
    python -m tests.strength table               # print the table of tests/strength.md
    python -m tests.strength check               # check that all faults can be inserted

``run`` works on copies of the repository. Of the tests that run the faulty line, it takes the
fastest of each file, then the second fastest of each, up to ``BUDGET_S`` seconds. A fault is found
if a test fails twice with it and passes without it. ``run`` can be interrupted and continued.
"""

import argparse
import ast
import collections
import json
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import zip_longest
from pathlib import Path
from queue import SimpleQueue

BUILD = Path("build")
RESULTS, COVERAGE, DURATIONS = (
    BUILD / "strength.jsonl",
    BUILD / ".coverage",
    BUILD / "durations.txt",
)
BUDGET_S, MOST_TESTS, TIMEOUT_S = 15.0, 80, 100
CRITICAL = ("stimulation/", "boards/")
COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "is": "is not"}
OPERATORS = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "&": "|", "|": "&"}
WORDS = {"and": "or", "or": "and"}


def faults_of(path):
    """Return all possible faults of a file, each as line, kind, and text of the changed file."""
    text = path.read_text("utf-8")
    starts = [0, *(match.end() for match in re.finditer("\n", text))]
    encoded = [line.encode() for line in text.split("\n")]

    def offset(line, column):
        return starts[line - 1] + len(encoded[line - 1][:column].decode())

    def span(node):
        first = offset(node.lineno, node.col_offset)
        return first, offset(node.end_lineno, node.end_col_offset)

    def swap(kind, line, first, last, new):
        return line, kind, text[:first] + new + text[last:]

    def between(kind, before, after, table):
        first, last = span(before)[1], span(after)[0]
        match = re.search(
            r"is not|not in|is|in|and|or|[<>=!]=|//|\*\*|<<|>>|[<>+*/%&|@-]", text[first:last]
        )
        if match and match[0] in table:
            at = first + match.start()
            yield swap(kind, before.end_lineno, at, at + len(match[0]), table[match[0]])

    def of_node(node):
        match node:
            case ast.Compare(left=left, comparators=[right, *_]):
                yield from between("comparison", left, right, COMPARISONS)
            case ast.BinOp(left=left, right=right):
                yield from between("arithmetic", left, right, OPERATORS)
            case ast.BoolOp(values=[left, right, *_]):
                yield from between("and/or", left, right, WORDS)
            case ast.Constant(value=bool(value)):
                yield swap("constant", node.lineno, *span(node), str(not value))
            case ast.Constant(value=int() | float()):
                yield swap(
                    "constant", node.lineno, *span(node), f"(2 * {text[slice(*span(node))]} + 1)"
                )
            case ast.Call(func=ast.Name(id="min" | "max" as name)):
                other = {"min": "max", "max": "min"}[name]
                yield swap("min/max", node.lineno, *span(node.func), other)
            case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
                condition = text[slice(*span(test))]
                yield swap("condition", test.lineno, *span(test), f"(not ({condition}))")
            case ast.Expr(value=ast.Call()) | ast.AugAssign():
                yield swap("statement left out", node.lineno, *span(node), "pass")
            case ast.Return(value=ast.AST() as value) if not isinstance(value, ast.Constant):
                yield swap("returns None", node.lineno, *span(value), "None")

    def visit(node):
        yield from of_node(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list") or isinstance(node, ast.Raise):
                continue  # skip types, decorators and error messages
            for inner in value if isinstance(value, list) else [value]:
                if isinstance(inner, ast.AST):
                    yield from visit(inner)

    return list(visit(ast.parse(text)))


def choose(faults, critical, seed, without):
    """Draw faults at random, weighted by file length. The first ``critical`` are in CRITICAL."""
    files = [
        path
        for path in sorted(Path("smarttouch").rglob("*.py"))
        if not re.search(without, str(path))
    ]
    pick, chosen = random.Random(seed), {}
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in files}
    dangerous = [path for path in files if str(path.relative_to("smarttouch")).startswith(CRITICAL)]
    while len(chosen) < faults:
        among = dangerous if dangerous and len(chosen) < critical else files
        path = pick.choices(among, [lines[path] for path in among])[0]
        possible = faults_of(path)
        if possible:
            line, kind, text = pick.choice(possible)
            chosen[str(path), line, kind] = text
    return chosen


def listed():
    """Return the faults that tests/strength.md lists by file, kind and source line."""
    chosen, missing = {}, []
    page = Path(__file__).with_suffix(".md").read_text("utf-8")
    for file, kind, source in re.findall(r"^- `(\S+\.py)` ([\w/ ]+): `(.*)`$", page, re.M):
        lines = Path(file).read_text("utf-8").splitlines() if Path(file).is_file() else []
        for line, own_kind, text in faults_of(Path(file)) if lines else ():
            if (own_kind, lines[line - 1].strip()) == (kind, source):
                chosen[file, line, kind] = text
                break
        else:
            missing.append(f"{file}: {source}")
    if missing:
        sys.exit("\n".join(["tests/strength.md lists faults in missing lines:", *missing]))
    return chosen


def check(options):
    """Check that each fault, listed or random, changes the code, and that the code compiles."""
    options.listed = False
    for faults in (listed(), chosen_faults(options)):
        for (file, line, kind), text in faults.items():
            assert text != Path(file).read_text("utf-8"), (file, line, kind)
            compile(text, file, "exec")
        print(f"{len(faults)} faults can be inserted")


def chosen_faults(options):
    """Return the faults that the command-line options select."""
    if options.listed:
        chosen = listed()
    else:
        chosen = choose(options.faults, options.critical, options.seed, options.without)
    folders = [Path("smarttouch", folder) for folder in options.folders or [""]]
    return {
        fault: text
        for fault, text in chosen.items()
        if any(map(Path(fault[0]).is_relative_to, folders))
    }


def tests_of_lines():
    """Return a function that finds the tests to run for a fault, given its file and line."""
    seconds = collections.defaultdict(float)
    for match in re.finditer(r"^([\d.]+)s \w+ +(\S.*)$", DURATIONS.read_text("utf-8"), re.M):
        seconds[match[2]] += float(match[1])
    database = sqlite3.connect(COVERAGE)
    rows = database.execute(
        "SELECT file.path, context.context, numbits FROM line_bits JOIN file ON file.id = file_id "
        "JOIN context ON context.id = context_id WHERE context.context != ''"
    )
    table = collections.defaultdict(list)
    for path, context, bits in rows:
        table[path[path.rindex("smarttouch/") :]].append((context.partition("|")[0], bits))

    def find(path, line):
        byte, bit = divmod(line, 8)
        runs = {test for test, bits in table[path] if byte < len(bits) and bits[byte] >> bit & 1}
        runs = runs or {test for test, _ in table[path]}  # runs at import: all tests of the file
        by_file = collections.defaultdict(list)
        for test in sorted(runs, key=lambda test: (seconds[test], test)):
            by_file[test.partition("::")[0]].append(test)
        chosen, spent = [], 0.0
        for test in filter(
            None, (test for turn in zip_longest(*by_file.values()) for test in turn)
        ):
            if len(chosen) < MOST_TESTS and (not chosen or spent + seconds[test] <= BUDGET_S):
                chosen.append(test)
                spent += seconds[test]
        return chosen

    return find


def failing(folder, tests):
    """Return the first test that fails, "" if all pass, or the reason why pytest stopped."""
    command = [sys.executable, "-m", "pytest", "-n0", "-xq", "-p", "no:cacheprovider", "--tb=no"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*command, "--timeout=60", *tests], cwd=folder, env=environment, text=True,
            capture_output=True, timeout=TIMEOUT_S + 2 * BUDGET_S, start_new_session=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "time is up"
    match = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.M)
    return match[1] if match else "" if done.returncode in (0, 5) else f"exit {done.returncode}"


def judge(folder, fault, text, tests):
    """Insert a fault and run tests. Return a record with the test that finds the fault, if any."""
    path, line, kind = fault
    file = folder / path
    before, left, found = file.read_text("utf-8"), list(tests), ""
    while left:
        file.write_text(text, "utf-8")
        found = failing(folder, left)
        again = "::" in found and failing(folder, [found])
        file.write_text(before, "utf-8")
        if "::" not in found or (again and not failing(folder, [found])):
            break
        left, found = left[left.index(found) + 1 :] if found in left else [], ""
    source = before.splitlines()[line - 1].strip()
    run = len(tests)
    return {"file": path, "line": line, "kind": kind, "source": source, "tests": run, "by": found}


def run(options):
    """Test the selected faults that have no result in RESULTS yet."""
    chosen = chosen_faults(options)
    done = set()
    if RESULTS.exists():
        rows = map(json.loads, RESULTS.read_text("utf-8").splitlines())
        done = {(row["file"], row["line"], row["kind"]) for row in rows}
    find, copies = tests_of_lines(), SimpleQueue()
    for number in range(options.copies):
        copy = BUILD.absolute() / f"copy{number}"
        ignored = shutil.ignore_patterns("build", ".venv", ".git", "__pycache__")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(".", copy, ignore=ignored)
        copies.put(copy)

    def one(item):
        fault, text = item
        folder = copies.get()
        try:
            result = judge(folder, fault, text, find(fault[0], fault[1]))
        finally:
            copies.put(folder)
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
        print(result["by"] or "SURVIVES", *fault, flush=True)

    with ThreadPoolExecutor(options.copies) as pool:
        list(pool.map(one, [item for item in chosen.items() if item[0] not in done]))


def table(_):
    """Print the share of faults found in each folder, and the faults that no test found."""
    rows = [json.loads(line) for line in RESULTS.read_text("utf-8").splitlines()]
    by_folder = collections.defaultdict(list)
    for row in rows:
        by_folder[Path(row["file"]).parts[1]].append(bool(row["by"]))
    print("| folder | faults | found | share |\n|---|---|---|---|")
    for name, found in [*sorted(by_folder.items()), ("all", [bool(row["by"]) for row in rows])]:
        print(f"| {name} | {len(found)} | {sum(found)} | {sum(found) / len(found):.0%} |")
    print("\nSurvivors:\n")
    for row in sorted(rows, key=lambda row: (row["file"], row["line"])):
        if not row["by"]:
            print(f"- `{row['file']}` {row['kind']}: `{row['source']}`")


def map_tests(_):
    """Run all tests and record the lines that each test runs."""
    BUILD.mkdir(exist_ok=True)
    COVERAGE.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", "--cov=smarttouch", "--cov-context=test"]
    environment = {**os.environ, "COVERAGE_FILE": str(COVERAGE.absolute())}
    with DURATIONS.open("w", encoding="utf-8") as file:
        more = ["--cov-report=", "--durations=0", "--durations-min=0"]
        subprocess.run([*command, *more], stdout=file, env=environment, check=False)
    if not COVERAGE.exists():
        sys.exit(f"no coverage was measured: install pytest-cov, or see {DURATIONS} for errors")


def main():
    """Run the command given on the command line."""
    parser = argparse.ArgumentParser(prog="tests.strength", description=__doc__)
    commands = parser.add_subparsers(required=True)
    commands.add_parser("map").set_defaults(function=map_tests)
    commands.add_parser("table").set_defaults(function=table)
    runner = commands.add_parser("run")
    runner.set_defaults(function=run)
    runner.add_argument("--copies", type=int, default=2, help="number of faults tested at once")
    runner.add_argument("--listed", action="store_true", help="only faults in tests/strength.md")
    checker = commands.add_parser("check")
    checker.set_defaults(function=check)
    for command in (runner, checker):
        command.add_argument("folders", nargs="*", help="only these folders, such as boards")
        command.add_argument("--faults", type=int, default=300)
        command.add_argument(
            "--critical", type=int, default=60, help="minimum of faults in stimulation and boards"
        )
        command.add_argument("--seed", type=int, default=4)
        command.add_argument("--without", default="^$", help="regex of paths to leave out")
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
