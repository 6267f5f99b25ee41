"""An image on its way into a session: as much of it as has come survives a stream that breaks off."""

import hashlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from capture_app.errors import NetworkError, TryAgainError
from capture_app.names import is_name
from capture_app.node.wire.messages import ImageReceipt, ImageUpload
from capture_app.session.files.disk import disk_error
from capture_app.session.files.durable import PART
from capture_app.session.writing.recovery import INCOMING

_BLOCK = 1 << 20


class PartialImage:
    """The file that one upload is written to; `camera.instant.sha256.part`, so that it can be found again."""

    def __init__(self, session: Path, upload: ImageUpload) -> None:
        record = upload.record
        self.upload = upload
        self.file = session / INCOMING / f"{record.camera}.{record.instant:06d}.{record.sha256}{PART}"
        self._handle = -1
        self._mutex = threading.Lock()

    def open(self) -> None:
        """Go on at the upload's offset. Raises TryAgainError where less than that has come before."""
        try:
            self.file.parent.mkdir(exist_ok=True)
            self._handle = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
            length = os.fstat(self._handle).st_size
            if length >= self.upload.offset:
                os.ftruncate(self._handle, self.upload.offset)
                os.lseek(self._handle, self.upload.offset, os.SEEK_SET)
                return
        except OSError as error:
            self.close()
            raise disk_error(error, self.file.parent) from error
        self.close()
        raise TryAgainError(
            f"this image goes on at byte {self.upload.offset}, but only {length} have arrived"
        )

    def add(self, chunk: bytes) -> None:
        """Write what has come. Raises DiskFullError, NetworkError after `close`."""
        left = memoryview(chunk)
        try:
            with self._mutex:
                if self._handle < 0:
                    raise NetworkError("this image is already arriving on another connection")
                while left:
                    left = left[os.write(self._handle, left) :]
        except OSError as error:
            self.close()
            raise disk_error(error, self.file.parent) from error

    def close(self) -> None:
        """Write no more. Calling it twice is harmless."""
        with self._mutex:
            if self._handle >= 0:
                os.close(self._handle)
                self._handle = -1

    def split_off_truth(self) -> bytes:
        """Check what has come, leave the image alone in the file, and return the ground truth.

        Raises TryAgainError, and deletes the file, where it is not what the upload tells; DiskError.
        """
        self.close()
        try:
            return self._split_off_truth()
        except OSError as error:
            raise disk_error(error, self.file.parent) from error

    def _split_off_truth(self) -> bytes:
        upload, record = self.upload, self.upload.record
        sha256 = hashlib.sha256()
        truth = b""
        with self.file.open("rb") as file:
            length = os.fstat(file.fileno()).st_size
            left = record.bytes
            while left and (block := file.read(min(left, _BLOCK))):
                sha256.update(block)
                left -= len(block)
            truth = file.read(upload.truth_bytes)
        whole = length == record.bytes + upload.truth_bytes and sha256.hexdigest() == record.sha256
        if whole and upload.truth_sha256 is not None:
            whole = hashlib.sha256(truth).hexdigest() == upload.truth_sha256
        if not whole:
            self.file.unlink()
            raise TryAgainError(f"the image of {record.camera} at instant {record.instant} arrived damaged")
        os.truncate(self.file, record.bytes)
        return truth


def partial_receipts(session: Path, camera: str) -> Iterator[ImageReceipt]:
    """Yield what has come of a camera's images whose streams broke off."""
    for file in sorted((session / INCOMING).glob(f"{camera}.*{PART}")):
        name, instant, sha256 = file.name.removesuffix(PART).rsplit(".", 2)
        if name == camera and is_name(camera):
            yield ImageReceipt(instant=int(instant), sha256=sha256, bytes=file.stat().st_size, stored=False)
