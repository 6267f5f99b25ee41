"""Errors by which a file system says that it does not have a call."""

import errno

_NOT_HERE = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP})
_NOT_ALLOWED = _NOT_HERE | {errno.EPERM, errno.EACCES}
_ERRORS = {
    "fsync": _NOT_HERE,
    "flock": _NOT_HERE | {errno.ENOLCK},
    "renameat2": _NOT_HERE,
    "link": _NOT_ALLOWED,
    "chmod": _NOT_ALLOWED,
}
"""By call. Virtual machines' shared folders, older CIFS and some FUSE have no sync of folders; NFS without
lockd, WSL 1 and some Lustre have no locks; Android's storage and some CIFS have no hard links or modes."""


def is_missing(call: str, error: int | None) -> bool:
    """Whether an `errno` of a call means that the file system does not have the call."""
    return error in _ERRORS[call]
