"""The option behind the parameter that an error of the library names."""

import pytest
from PIL import Image

from .conftest import refused


@pytest.mark.parametrize(("arguments", "options"), [
    ("live --scan frame --hold charge", "--scan"),
    ("live --board vibrators:x.wav", "--board, --vibrators"),
    ("mouse --rate 300 --board memory:", "--rate"),
    ("read text:hi --speed 0 --board memory:", "--speed"),
    ("read text:hi --pause -1 --board memory:", "--pause"),
    ("calibrate registration --dot-pitch-mm 0", "--dot-pitch-mm"),
    ("calibrate force --simulate --output run.txt", "--output"),
    ("board test memory: --current-ma 9 --seconds 1", "--current-ma"),
    ("sensor emulate serial-array --sensor camera:0", "--sensor"),
])  # fmt: skip
def test_options_end_the_sentence(program_here, tmp_path, arguments, options):
    Image.new("L", (20, 20)).save(tmp_path / "page.png")
    done = program_here(*arguments.split(" "))
    refused(done)
    assert done.stderr.endswith(f" ({options})\n")
    assert done.stderr.count("(--") == 1


@pytest.mark.parametrize("arguments", ["profiles show nobody", "boards extra", "live --seed x"])
def test_nothing_ends_what_no_option_is_about(program_here, arguments):
    done = program_here(*arguments.split(" "))
    assert done.returncode == 2
    assert "(--" not in done.stderr
