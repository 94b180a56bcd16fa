"""Tests of the core with ports that are slow, interrupt it, or lack fields. Other tests check size
and stack of the core on a small processor, and the required rules of MISRA.

``pytest -n0 -s firmware/tests/test_faulty_ports.py`` prints size and stack.
"""

import re
import shutil
import subprocess

import pytest

from firmware.tests.builds_and_machines import SOURCES, built, changed

SAFE = "as safe as can be"
LEFT_OUT = {
    "electrodes": 1, "output": 1, "features": 0, "most_slots": 1, "compliance_v": 0, "ramp_ms": 0,
    "most_kernels": 1, "packet_bytes": 1, "kernel_bytes": 1, "buffer[0]": 1, "buffer[1]": 1,
    "buffer[2]": 1, "kernels": 1, "kernel_at": 1, "sums": 1, "current_ua": 1, "pulse_ua": 1,
    "each": 1, "volts": 1, "name": 1,
}  # fmt: skip
NOT_THERE = {
    "now_us": 1, "draw": 1, "send": 1, "pulse": 1, "shorted": 1, "force_mn": 1, "volts": 1,
    "left_pc": 0, "emergency_open": 1,
}  # fmt: skip


def check(program, *words, seconds=590):
    """Run a program and return its output; raise `AssertionError` if it reports a fault."""
    # A program that lacks a guard may never end.
    command = ["timeout", str(seconds), program, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def checks(name="st_checks"):
    return built("checks", name, "cc")


@pytest.mark.parametrize("slots", [1_500, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_the_rest_is_kept_however_long_a_port_takes(slots):
    """The port's functions take 0 to 500 µs at random, and sometimes call `st_zero`."""
    found = re.match(
        r"(\d+) slots, 0 overlaps, 0 after (\d+) zeros", check(checks(), "times", slots)
    )
    assert int(found[1]) >= slots
    assert int(found[2]) > slots / 400


def test_an_interrupt_ends_all():
    """The thread sanitizer ends the program if two threads access the same memory at once."""
    assert " 0 overlaps, 0 after " in check(checks("st_checks_threads"), "interrupts", 1000)


def test_a_field_that_is_left_out_is_safe_or_named():
    found = dict(line.split(": ", 1) for line in check(checks(), "init").splitlines())
    for kind, fields in (("config", LEFT_OUT), ("port", NOT_THERE)):
        for field, named in fields.items():
            said = found.pop(f"{kind}.{field}")
            assert (field.partition("[")[0] in said) if named else (said == SAFE)
            assert "BUT" not in said
    assert found.pop("nothing left out") == SAFE
    assert "stands still" in found.pop("a clock that stands")
    assert "steps" in found.pop("a clock of milliseconds")
    assert found == {}


ENGINE, SETUP = "st_engine.c", "st_init.c"
MUTANTS = {
    "begin of a pulse from the port": (
        "times", ENGINE, "begun_us = board->port.", "begun_us = before_us + 0 * board->port."
    ),
    "discharge after a previous session": ("times", ENGINE, "|| before_us < board->free_us", ""),
    "zero before a pulse": (
        "times", ENGINE, "    return __atomic_load_n", "    return true || __atomic_load_n"
    ),
    "zero in a pulse": ("times", ENGINE, "    if (reason != NULL) {", "    if (0) {"),
    "clock stands still": ("init", SETUP, "if (steps < CLOCK_STEPS)", "if (steps > CLOCK_STEPS)"),
    "port without `pulse`": ("init", SETUP, "|| port->pulse == NULL", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.long) for name in MUTANTS])
def test_a_core_without_one_guard_is_found_out(tmp_path, name):
    what, *change = MUTANTS[name]
    program = changed(tmp_path, *change, "-pthread", "fuzz/st_port_checks.c")
    try:
        found = check(program, what, 100_000, seconds=30)
    except AssertionError:
        return
    assert what == "init"
    assert found != check(checks(), "init")


@pytest.mark.long
@pytest.mark.parametrize("shift", [2, 3, 4, 6])
def test_rests_on_a_cortex_m3(shift):
    """At 15.6 to 250 MIPS, slots of 1 to 24 kernels keep their discharge times or are refused."""
    elf = built("measure", "st_measure.elf", "arm-none-eabi-gcc", "qemu-system-arm")
    command = ["qemu-system-arm", "-M", "mps2-an385", "-kernel", elf, "-display", "none",
               "-monitor", "none", "-semihosting", "-icount", f"shift={shift}", "-serial",
               "stdio", "-serial", "null"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, check=True, timeout=300)
    said = done.stdout.decode(errors="replace")
    rests = [tuple(map(int, each)) for each in re.findall(r"^rest" + r" (\d+)" * 6, said, re.M)]
    refused = re.findall(r"^refused" + r" (\d+)" * 6 + "$", said, re.M)
    assert len(rests) + len(refused) == 15
    assert [each for each in rests if each[4] < each[2] or each[3] != 32] == []
    # Only rule 27 refuses slots. It needs a previous slot, so it never refuses the first one.
    assert [each for each in refused if int(each[3]) != 27 or not 0 < int(each[4]) < 32] == []
    assert len(rests) >= (15 if shift < 4 else 5)
    # Each of the 32 slots may take 150 µs more than requested. The pass may begin 6 ms late.
    assert [each for each in rests if each[5] > 32 * (250 + each[2]) + 6000] == []


@pytest.mark.long
def test_what_was_built_with_other_options_is_built_again(tmp_path):
    """Otherwise a kit could get the firmware of another, with four times the current per count."""
    if not SOURCES.is_dir() or shutil.which("make") is None or shutil.which("cc") is None:
        pytest.skip("needs the folder firmware, make and cc")
    times = []
    for more in ("-DST_SILENCE_US=100000u", "-DST_SILENCE_US=100000u", ""):
        command = ["make", "-s", "-C", SOURCES, f"BUILD={tmp_path}", "CFLAGS=-O0", f"MORE={more}"]
        subprocess.run(command, check=True)
        times.append((tmp_path / "st_host").stat().st_mtime_ns)
    assert times[0] == times[1] < times[2]


ADVISORY = re.compile(
    r"1\.2|2\.[34567]|4\.2|5\.9|8\.(7|9|11|13)|10\.5|11\.[45]|12\.[134]|13\.[34]|15\.[145]"
    r"|17\.[58]|18\.[45]|19\.2|20\.[15]|21\.12"
)
"""Advisory rules of MISRA C:2012."""


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
    files = [each for each in (SOURCES / "src").glob("*.c") if each.name != "st_shift_registers.c"]
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
    print(f"\ncode {size} bytes, stack {deep} bytes without the port's functions")
    page = (SOURCES / "README.md").read_text(encoding="utf-8")
    said = re.search(r"(\d+) kB of code, ([\d.]+) kB of stack", page)
    assert size <= 1000 * float(said[1])
    assert deep <= 1000 * float(said[2])
