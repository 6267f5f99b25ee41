"""The buffers of a stream of libcamera, mapped once, and their pictures copied out of them."""

import mmap
from typing import Any

from capture_app.cameras.v4l2.layout import PixelFormat
from capture_app.cameras.v4l2.pictures import JpegPicture, RawPicture, picture_from_buffer


class MappedBuffers:
    """The memory of a stream's buffers."""

    def __init__(self, module: Any, camera: Any, stream: Any, layout: PixelFormat) -> None:
        """Allocate and map what a configured stream needs. Raises what the library raises, OSError."""
        self._allocator = module.FrameBufferAllocator(camera)
        self._allocator.allocate(stream)
        self._layout = layout
        self.buffers = list(self._allocator.buffers(stream))
        self._memory: dict[int, mmap.mmap] = {}
        lengths: dict[int, int] = {}
        for plane in (plane for buffer in self.buffers for plane in buffer.planes):
            lengths[plane.fd] = max(lengths.get(plane.fd, 0), plane.offset + plane.length)
        for fd, length in lengths.items():
            self._memory[fd] = mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ)

    def picture(self, buffer: Any) -> JpegPicture | RawPicture | None:
        """The picture in a finished buffer; None where it is damaged."""
        filled = zip(buffer.planes, buffer.metadata.planes, strict=True)
        data = b"".join(
            self._memory[plane.fd][plane.offset : plane.offset + used.bytes_used] for plane, used in filled
        )
        return picture_from_buffer(data, self._layout)

    def close(self) -> None:
        """Let go of the memory."""
        for memory in self._memory.values():
            memory.close()
        self._memory, self.buffers, self._allocator = {}, [], None
