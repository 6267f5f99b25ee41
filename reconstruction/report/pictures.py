"""The pictures of a report: both sides over each other, parted by a slider."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from reconstruction.report import wording
from reconstruction.report.burst import embed
from reconstruction.scores.results import Picture


def pictures_section(pictures: Sequence[Picture], out: Path, sides: wording.Sides) -> str:
    """All pictures of a pair; nothing where there are none. Raises BadInputError where one is missing."""
    if not pictures:
        return ""
    # What can be wiped comes first: it shows the difference at once.
    ordered = sorted(pictures, key=lambda picture: picture.panels > 1)
    figures = "\n".join(figure(picture, out, sides) for picture in ordered)
    return f"""<section aria-labelledby="pictures">
<h2 id="pictures">See the difference</h2>
<fieldset class="view"><legend>Show the two</legend>
<label><input type="radio" name="view" value="over" checked> over each other (drag, or arrow keys)</label>
<label><input type="radio" name="view" value="beside"> side by side</label></fieldset>
{figures}
</section>"""


def figure(picture: Picture, out: Path, sides: wording.Sides) -> str:
    """Both sides of a picture, one over the other with a slider where that shows something."""
    title = escape(picture.title)
    synced, (wide, high) = embed(out / picture.synced)
    offset, _ = embed(out / picture.offset)
    first, late = escape(sides.first), escape(sides.late_head)
    caption = f"<figcaption>{escape(wording.tie(picture.caption))}</figcaption>" if picture.caption else ""
    slider = (
        f"""<input class="wipe" type="range" min="0" max="100" value="50" data-left="{first.lower()}"
 aria-label="{title}: how much to show of: {first.lower()}"><span class="handle"></span>"""
        if picture.panels == 1
        else ""
    )
    return f"""<h3 class="picture">{title}</h3>
<figure aria-label="{title}">
<div class="pair {"over" if slider else "stack"}" style="--shape: {wide / high:.4f}; --wide: {wide}">
<div class="side synced"><span class="tag">{first}</span>
<img alt="{title}, {first.lower()}" width="{wide}" height="{high}" src="{synced}"></div>
<div class="side offset"><span class="tag">{late}</span>
<img alt="{title}, {late}" width="{wide}" height="{high}" src="{offset}"></div>
{slider}
</div>
{caption}</figure>"""
