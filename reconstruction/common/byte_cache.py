"""Arrays kept for the next time, the longest unused dropped first, up to a number of bytes."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

from reconstruction.common.geometry import Array


class ByteCache:
    """A function from keys to arrays whose last results are kept."""

    def __init__(self, make: Callable[..., Array], limit_bytes: int) -> None:
        self._make = make
        self._limit_bytes = limit_bytes
        self._bytes = 0
        self._kept: OrderedDict[tuple[Hashable, ...], Array] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, *key: Hashable) -> Array:
        """The array of a key, kept or made."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = self._make(*key)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._bytes += made.nbytes
            # The newest is kept however large it is: it is asked for again at once.
            while self._bytes > self._limit_bytes and len(self._kept) > 1:
                _, dropped = self._kept.popitem(last=False)
                self._bytes -= dropped.nbytes
        return made
