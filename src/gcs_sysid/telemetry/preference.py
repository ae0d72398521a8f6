"""Of messages with the same content, the best that arrives."""

from collections.abc import Sequence

import numpy as np

from gcs_sysid.arrays import Array, Mask

PREFERRED_FOR = 1.0
"""s. The next best message is used only when no better one came for this long."""


class Preference:
    """Lets messages of a stream through only while none that ranks better comes."""

    def __init__(self) -> None:
        self._heard: dict[int, float] = {}

    def allows(self, ranked: Sequence[tuple[int, Array, Array]]) -> list[Mask]:
        """Note messages, and return which of them to use.

        Args:
            ranked: of each kind its rank, the (n,) places of its messages in the order of
                arrival, and their times in s, NaN where there is none; the best first.

        Returns:
            Of each kind (n,) whether to use the message.
        """
        heard: list[tuple[int, Array, Array]] = []
        masks = []
        came = {rank for rank, _, _ in ranked}
        silent = [(k, t) for k, t in self._heard.items() if k not in came]
        for rank, order, t in ranked:
            allowed = np.ones(len(t), bool)
            for better, last in silent:
                if better < rank:
                    allowed &= ~(np.abs(t - last) <= PREFERRED_FOR)
            for better, better_order, better_t in heard:
                if better < rank:
                    last_t = better_t[np.searchsorted(better_order, order)]
                    allowed &= ~(np.abs(t - last_t) <= PREFERRED_FOR)
            masks.append(allowed)
            timed = np.isfinite(t)
            times = np.concatenate([[self._heard.get(rank, np.nan)], t[timed]])
            heard.append((rank, order[timed], times))
            if len(times) > 1:
                self._heard[rank] = float(times[-1])
        return masks
