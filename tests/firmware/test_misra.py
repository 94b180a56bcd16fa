"""MISRA's required rules over the core, by cppcheck's add-on; deviations are listed."""

import re
import shutil
import subprocess

import pytest

from tests.firmware.build import SOURCES, WHOLE

ADVISORY = re.compile(
    r"1\.2|2\.[34567]|4\.2|5\.9|8\.(7|9|11|13)|10\.5|11\.[45]|12\.[134]|13\.[34]|15\.[145]"
    r"|17\.[58]|18\.[45]|19\.2|20\.[15]|21\.12"
)
"""Rules that MISRA C:2012 only advises."""


@WHOLE
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
