from capture_app.common.errors import SimulshotError as SimulshotError
from capture_app.rig.rig import AsyncRig as AsyncRig
from capture_app.rig.rig import Rig as Rig
from capture_app.rig.taking import TakePlan as TakePlan
from capture_app.session.exporting.exported_burst import ExportedBurst as ExportedBurst
from capture_app.session.exporting.exporter import Exporter as Exporter
from capture_app.session.reading.array_access import open_session as open_session

__version__: str
