"""Printed pages as pictures, from their SVG or PDF."""

import re

import cv2
import numpy as np
from numpy.typing import NDArray

PX_PER_MM = 6.0
NUMBER = r"(-?[\d.]+)"


def draw(size_mm: tuple[float, float], parts: list[tuple[int, list[tuple[float, ...]]]]) -> NDArray[np.uint8]:
    """A page of grey rectangles (left, top, width, height; mm), four times as fine and made smaller."""
    fine = 4 * PX_PER_MM
    page = np.full((round(size_mm[1] * fine), round(size_mm[0] * fine)), 255, np.uint8)
    for level, rectangles in parts:
        for left, top, width, height in rectangles:
            x, y = round(left * fine), round(top * fine)
            page[y : round((top + height) * fine), x : round((left + width) * fine)] = level
    return np.asarray(cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), np.uint8)


def read_svg(data: bytes) -> tuple[tuple[float, float], NDArray[np.uint8]]:
    """The page's size in mm and its picture."""
    text = data.decode()
    size = re.search(rf'width="{NUMBER}mm" height="{NUMBER}mm" viewBox="0 0 {NUMBER} {NUMBER}"', text)
    assert size is not None
    assert size[1] == size[3]
    assert size[2] == size[4]
    parts = []
    for colour, path in re.findall(r'<path fill="#(\w+)" d="([^"]*)"', text):
        found = re.findall(rf"M{NUMBER} {NUMBER}h{NUMBER}v{NUMBER}h{NUMBER}z", path)
        parts.append((255 * (colour == "fff"), [tuple(map(float, one[:4])) for one in found]))
    mm = float(size[1]), float(size[2])
    return mm, draw(mm, parts)


def read_pdf(data: bytes) -> tuple[tuple[float, float], NDArray[np.uint8]]:
    """As `read_svg`; also that the table of objects points at them."""
    text = data.decode("latin-1")
    for number, start in enumerate(re.findall(r"(\d{10}) 00000 n", text), 1):
        assert text[int(start) :].startswith(f"{number} 0 obj")
    assert text[int(re.findall(r"startxref\n(\d+)", text)[0]) :].startswith("xref")
    stream = re.search(r"/Length (\d+) >>\nstream\n(.*)\nendstream", text, re.DOTALL)
    assert stream is not None
    assert int(stream[1]) == len(stream[2])
    box = re.search(rf"MediaBox \[0 0 {NUMBER} {NUMBER}\]", text)
    assert box is not None
    matrix = re.search(rf"^{NUMBER} 0 0 {NUMBER} 0 {NUMBER} cm", stream[2])
    assert matrix is not None
    points_per_unit = float(matrix[1])
    assert float(matrix[2]) == -points_per_unit
    assert matrix[3] == box[2]
    mm_per_unit = points_per_unit * 25.4 / 72
    parts: list[tuple[int, list[tuple[float, ...]]]] = []
    for line in stream[2].splitlines():
        if fill := re.fullmatch(r"([01]) g", line):
            parts.append((255 * int(fill[1]), []))
        elif box_of := re.fullmatch(rf"{NUMBER} {NUMBER} {NUMBER} {NUMBER} re", line):
            parts[-1][1].append(tuple(float(value) * mm_per_unit for value in box_of.groups()))
    mm = float(box[1]) * 25.4 / 72, float(box[2]) * 25.4 / 72
    return mm, draw(mm, parts)
