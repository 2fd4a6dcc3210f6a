"""Tables of set points for the tests of models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.set_point_table import SetPointTable


def set_points(
    times: NDArray[np.int64],
    replies: NDArray[np.int64] | None = None,
    codes: NDArray[np.int64] | None = None,
    frames: NDArray[np.int64] | None = None,
) -> SetPointTable:
    """Make set points that are answered at once and at the first attempt; frames are 1, 3, 5 and so on."""
    count = len(times)
    frames = np.arange(count) * 2 + 1 if frames is None else frames
    return SetPointTable(
        origin=0,
        calls=list(range(1, count + 1)),
        times=times,
        arrivals=times,
        replies=times if replies is None else replies,
        answered=np.ones(count, np.bool_),
        open=np.zeros(count, np.bool_),
        codes=np.zeros(count, np.int64) if codes is None else codes,
        frames=frames,
        reply_frames=frames + 1,
        retries=np.zeros(count, np.int64),
        irregular=(),
    )
