"""Fixtures that these tests share with those of other folders."""

from tests.unit.reconstruction.conftest import boards as boards
from tests.unit.reconstruction.conftest import own_data_folder as own_data_folder
from tests.unit.reconstruction.conftest import reconstruct as reconstruct
from tests.unit.reconstruction.conftest import scene as scene
