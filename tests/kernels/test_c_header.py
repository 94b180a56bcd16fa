"""The C header of kernels, compiled with the firmware: its currents are the host's, to the bit."""

import shutil
import subprocess

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import DesignError
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.stimulation.scan_sequence import KernelLists

from ..firmware.build import SOURCES
from ..raising import raises
from ..whole import sample

PROGRAM = """
#include <stdio.h>
#include <string.h>
#include "st_inside.h"
#include "kernels.h"

static uint8_t kept[ST_KERNEL_IMAGE_BYTES], load[ST_LOAD_HEAD + ST_KERNEL_IMAGE_BYTES];
static uint32_t kernel_at[ST_KERNEL_COUNT];
static int32_t sums[ST_KERNEL_ELECTRODES];
static int16_t current_ua[ST_KERNEL_ELECTRODES];
static st_board board;
static st_sequence sequence;

int main(void)
{
    uint8_t pairs[4 * 8];
    st_place place = { .kind = ST_SUM };
    board.config = (st_config){ .electrodes = ST_KERNEL_ELECTRODES, .kernels = kept,
                                .kernel_bytes = sizeof kept, .kernel_at = kernel_at,
                                .most_kernels = ST_KERNEL_COUNT, .sums = sums,
                                .current_ua = current_ua };
    memcpy(load, st_table_identity, sizeof st_table_identity);
    (void)st_put_u32(load + ST_IDENTITY_BYTES, ST_KERNEL_IMAGE_BYTES);
    memcpy(load + ST_LOAD_HEAD, st_table_image, sizeof st_table_image);
    st_keep_take(&board, load, sizeof load);
    if (!board.keep.whole || board.keep.count != ST_KERNEL_COUNT) {
        return 1;
    }
    for (unsigned row = 0; row < ST_KERNEL_COUNT; row++) {
        memset(sums, 0, sizeof sums);
        st_add_kernel(&board, row, 1);
        for (unsigned each = 0; each < ST_KERNEL_ELECTRODES; each++) {
            if (sums[each] != st_table_weight[row][each]) {
                return 2;
            }
        }
        if (st_kernel_site(&board, row) != st_table_site[row]) {
            return 3;
        }
    }
    while (fread(pairs, sizeof pairs, 1, stdin) == 1) {
        uint16_t source_ua;
        sequence.data = pairs;
        place.pairs = 8;
        (void)st_slot_currents(&board, &sequence, &place, current_ua, &source_ua);
        (void)fwrite(current_ua, sizeof current_ua, 1, stdout);
    }
    return 0;
}
"""


@pytest.mark.parametrize("name", sample(["line-8", "electric-mouse"]))
def test_the_firmware_makes_the_host_s_currents_of_it(name, tmp_path):
    compiler = shutil.which("cc")
    if compiler is None or not SOURCES.is_dir():
        pytest.skip("needs cc and the folder firmware")
    profile = st.load_profile(name)
    kernels = st.load_kernels(profile)
    kernels.to_c(tmp_path / "kernels.h")
    program = tmp_path / "check.c"
    program.write_text(PROGRAM, encoding="utf-8")
    command = [compiler, "-std=c11", "-Wall", "-Wextra", "-Werror", "-I", SOURCES / "src"]
    command += [program, *sorted((SOURCES / "src").glob("*.c")), "-o", tmp_path / "check"]
    subprocess.run(command, check=True)
    table = Pipeline(profile, kernels, RunConfig(scan="points"), in_sums=True).table
    image = KernelImage.of(table, 1 << 24, 0xFFFF)
    assert (
        f"#define ST_KERNEL_IMAGE_BYTES {len(image.data)}\n" in (tmp_path / "kernels.h").read_text()
    )
    random = np.random.default_rng(1)
    kernel = random.integers(0, len(table.weights), (500, 8)).astype("<u2")
    amplitude = random.integers(0, 0xFFFF // 8, (500, 8)).astype("<u2")
    given = np.stack([kernel, amplitude], axis=-1).tobytes()
    done = subprocess.run([tmp_path / "check"], input=given, capture_output=True, check=True)
    found = np.frombuffer(done.stdout, "<i2").reshape(500, -1)
    lists = KernelLists(table, np.arange(0, 4001, 8), kernel.ravel(), amplitude.ravel())
    np.testing.assert_array_equal(found, lists.current_ua())
    assert not found.sum(axis=1).any()
    assert found.any(axis=1).all()


def test_a_header_that_cannot_be_written_is_one_sentence(tmp_path):
    kernels = st.load_kernels(st.load_profile("line-8"))
    with raises(DesignError, value=str(tmp_path)):
        kernels.to_c(tmp_path)
