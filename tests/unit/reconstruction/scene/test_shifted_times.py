"""Assignment of images to instants after a time shift."""

from capture_app.session.format.manifest import ImageRecord
from reconstruction.scene.dataset import shift_times


def test_of_two_images_at_one_instant_the_nearer_one_is_used() -> None:
    records = [
        ImageRecord(camera="a", instant=k, path=f"{k}.png", leader_ns=at_ns, bytes=1, sha256="")
        for k, at_ns in enumerate((30_000_000, 70_000_000))
    ]
    for shift_ms, instant, path in ((-25.0, 0, "0.png"), (25.0, 1, "1.png")):
        placed = shift_times(records, {"a": shift_ms}, (0, 100_000_000), 100_000_000)
        assert {place: record.path for place, record in placed.items()} == {("a", instant): path}
