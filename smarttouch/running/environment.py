"""State of the process while a run paces: nothing long is left to do, nothing gets in between."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from smarttouch.running.pipeline import Pipeline


@contextmanager
def steady_environment(pipeline: Pipeline, simulated_time: bool = False) -> Iterator[None]:
    """Warm a pipeline up, freeze garbage collection and keep OpenCV to one thread in the block.

    Before a board is open: it would take the delay for a lost host. In simulated time, where
    nothing is late, OpenCV alone is kept to one thread.
    """
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves, and takes the other core.
    cv2.setNumThreads(1)
    freezes = not simulated_time and not gc.get_freeze_count()
    if not simulated_time:
        pipeline.warm_up()
    # What a program has frozen for itself stays so.
    if freezes:
        gc.freeze()
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        if freezes:
            gc.unfreeze()
