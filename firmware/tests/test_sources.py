"""What the core takes of a small processor, and which of MISRA's required rules it keeps.

``pytest -n0 -s firmware/tests/test_sources.py`` prints its size.
"""

import re
import shutil
import subprocess

import pytest

from firmware.tests.build import SOURCES

ADVISORY = re.compile(
    r"1\.2|2\.[34567]|4\.2|5\.9|8\.(7|9|11|13)|10\.5|11\.[45]|12\.[134]|13\.[34]|15\.[145]"
    r"|17\.[58]|18\.[45]|19\.2|20\.[15]|21\.12"
)
"""Rules that MISRA C:2012 only advises."""


@pytest.mark.long
def test_required_rules_are_kept_but_for_those_listed():
    if not SOURCES.is_dir() or shutil.which("cppcheck") is None:
        pytest.skip("needs the folder firmware and cppcheck")
    files = sorted((SOURCES / "src").glob("*.c"))
    command = ["cppcheck", "--addon=misra", "--std=c11", "-q", "--platform=unspecified"]
    done = subprocess.run(
        [*command, f"-I{SOURCES / 'src'}", *files], capture_output=True, text=True, check=True
    )
    found = set(re.findall(r"misra-c2012-([\d.]+)\]", done.stderr))
    required = {each for each in found if not ADVISORY.fullmatch(each)}
    assert required < found
    listed = set(re.findall(r"^(\d+\.\d+) ", (SOURCES / "misra.txt").read_text("utf-8"), re.M))
    assert required == listed, done.stderr


def test_size_and_deepest_stack_are_as_documented(tmp_path):
    if not SOURCES.is_dir() or shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("needs the folder firmware and arm-none-eabi-gcc")
    files = [each for each in (SOURCES / "src").glob("*.c") if each.name != "st_kit.c"]
    command = ["arm-none-eabi-gcc", "--specs=picolibc.specs", "-mcpu=cortex-m4", "-mthumb", "-Os"]
    command += ["-fcallgraph-info=su", "-c", *files]
    subprocess.run(command, cwd=tmp_path, check=True)
    command = ["arm-none-eabi-size", "-t", *tmp_path.glob("*.o")]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    size = int(found.splitlines()[-1].split()[0])
    stack, calls = {}, {}
    for path in tmp_path.glob("*.ci"):
        text = path.read_text()
        for name, taken in re.findall(r'node: { title: "(\S+)" label: ".*?(\d+) bytes', text):
            stack[name] = int(taken)
        for caller, called in re.findall(r'sourcename: "(\S+)" targetname: "(\S+)"', text):
            calls.setdefault(caller, set()).add(called)

    def deepest(name):
        return stack.get(name, 0) + max(map(deepest, calls.get(name, ())), default=0)

    deep = max(deepest(f"st_{each}") for each in ("init", "feed", "advance", "hang_up"))
    print(f"\ncode {size} bytes, stack {deep} bytes beside what the port's functions take")
    page = (SOURCES / "README.md").read_text(encoding="utf-8")
    said = re.search(r"(\d+) kB of code, ([\d.]+) kB of stack", page)
    assert size <= 1000 * float(said[1])
    assert deep <= 1000 * float(said[2])
