"""What comes back of tactile colors that were split, mixed and delivered.

Run with::

    pytest tests/benchmarks/test_color.py --benchmark-only -n0 -s

Each class alone, every pair, and all three: rate and drive of every class, told from the
currents that an emulated board delivered, beside what it had answered; how far pulses
were from their own time. Then what a frame costs, and who answers where from 5 to 500 Hz.
"""

import itertools

import numpy as np

from smarttouch.color.mix import mix_colors
from smarttouch.color.sensor import ColorSensor
from smarttouch.color.spec import open_trace
from smarttouch.color.split import split
from smarttouch.primary import Primary

from ..color.delivered import feel
from ..color.test_delivered import ALONE

SECONDS = 10.0


def mixtures():
    for count in (1, 2, 3):
        for classes in itertools.combinations(Primary, count):
            yield "+".join(ALONE[each][0] for each in classes)


def test_what_comes_back(profile, bank, benchmark):
    def measure():
        print(f"\n{'felt':48} class  answered      delivered     off by, ms")
        for spec in mixtures():
            got, sensor = feel(spec, profile, bank, seconds=SECONDS)
            answers = split(open_trace(spec, SECONDS), sai_full_n=profile.force.full_n)
            for primary, row in got.items():
                answer = answers[primary]
                off_ms = np.abs(sensor.error_us(primary)) / 1000
                print(
                    f"{spec:48} {primary.name:5} {answer.mean_rate_hz:6.1f} "
                    f"{answer.mean_drive:5.2f}"
                    f"  {row.rate_hz:6.1f} {row.drive.mean():5.2f}"
                    f"  {np.median(off_ms):5.2f} / {off_ms.max():4.2f}"
                )
            spread = {each: answers[each].peak_drive for each in Primary if each not in got}
            assert max(spread.values(), default=0) < 0.01

    benchmark.pedantic(measure, rounds=1)


def test_who_answers_where(benchmark):
    def measure():
        print("\n    Hz   " + "".join(f"{um:>3} µm: RA   SAI   PC   " for um in (3, 10, 100)))
        for hz in (5, 10, 15, 20, 30, 45, 60, 75, 100, 150, 250, 400, 500):
            cells = []
            for um in (3, 10, 100):
                answers = split(open_trace(f"tone:{hz}Hz,{um}um", 1.0))
                cells += [f"{np.median(answers[each].drive):.2f}" for each in Primary]
            print(f"{hz:6d}   " + "  ".join(cells))

    benchmark.pedantic(measure, rounds=1)


def test_a_frame(profile, bank, benchmark):
    spec = "tone:30Hz,6um+tone:250Hz,1.5um+press:0.45N"
    mixture = mix_colors(open_trace(spec, SECONDS), profile, bank)

    def every_frame():
        sensor, now_us, frames = ColorSensor(spec, profile, mixture), 0, 0
        while (frame := sensor.read(1000 * now_us)) is not None:
            now_us += frame.request.period_us
            frames += 1
        return frames

    frames = benchmark(every_frame)
    print(f"\n{1e6 * benchmark.stats.stats.median / frames:.1f} µs a frame, {frames} frames")


def test_splitting_and_mixing(profile, bank, benchmark):
    trace = open_trace("noise:5-400Hz,5um+press:0.5N", SECONDS)
    benchmark(lambda: mix_colors(trace, profile, bank))
