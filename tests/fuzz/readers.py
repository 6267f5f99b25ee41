"""What the fuzzer feeds: each reader takes any bytes, and raises what users are told of or nothing.

A reader of files is given a folder of its own, in which it may write what it likes.
"""

from pathlib import Path

from capture_app.protocol import messages
from tests.fuzz.folders import Reader
from tests.fuzz.import_readers import (
    import_exported,
    import_file,
    import_whole,
    read_calibration,
    read_gopro,
    read_picture,
    read_rig,
    read_sidecar,
    read_sound_file,
    read_table,
)
from tests.fuzz.joint_readers import read_joints
from tests.fuzz.network_readers import (
    read_app_phone,
    read_datagram,
    read_pairing_word,
    read_phone_page,
    read_sealed,
    read_stream,
)
from tests.fuzz.session_readers import (
    SESSION_FILES,
    read_ground_truth,
    read_known_machines,
    read_profiles,
    read_session_file,
    read_spool,
    repair_session,
)

READERS: dict[str, Reader] = {
    "datagram": read_datagram,
    "stream-of-node": read_stream(messages.ToLeader),
    "stream-of-leader": read_stream(messages.FromLeader),
    "phone-page": read_phone_page,
    **{f"session-{Path(name).stem}": read_session_file(name) for name in SESSION_FILES},
    "repair": repair_session,
    "ground-truth": read_ground_truth,
    "spool": read_spool,
    "profiles": read_profiles,
    "picture": read_picture,
    "import-picture": import_file("000001.jpg"),
    "import-video": import_file("video.mp4"),
    "import-bag": import_whole("film.bag"),
    "sound": read_sound_file,
    "joints-coco": read_joints(".json"),
    "joints-deeplabcut": read_joints(".csv"),
    "joints-hdf5": read_joints(".h5"),
    "joints-freemocap": read_joints(".npy"),
    "gopro": read_gopro,
    "table": read_table,
    "calibration-toml": read_calibration("camera_array.toml"),
    "calibration-qualisys": read_calibration("rig.qca.txt"),
    "calibration-kalibr": read_calibration("camchain.yaml"),
    "calibration-euroc": read_calibration("sensor.yaml"),
    "calibration-kitti": read_calibration("calib_cam_to_cam.txt"),
    "calibration-panoptic": read_calibration("calibration_171204.json"),
    "calibration-handpose3d": read_calibration("c0.dat"),
    "calibration-deeplabcut": read_calibration("stereo_params.pickle"),
    "calibration-llff": read_calibration("poses_bounds.npy"),
    "calibration-matlab": read_calibration("stereo.mat"),
    "calibration-metashape": read_calibration("cameras.xml"),
    "calibration-opensfm": read_calibration("reconstruction.json"),
    "calibration-realitycapture": read_sidecar,
    "calibration-ros": read_calibration("left.yaml"),
    "calibration-opencv": read_calibration("left.yml"),
    "calibration-npz": read_calibration("left.npz"),
    "calibration-pickle": read_calibration("cameraIntrinsicsExtrinsics.pickle"),
    "calibration-easymocap": read_rig("intri.yml"),
    "calibration-colmap": read_rig("cameras.bin"),
    "calibration-colmap-text": read_rig("cameras.txt"),
    "export-colmap": import_exported("colmap", "simulshot.json"),
    "export-nerfstudio": import_exported("nerfstudio", "transforms.json"),
    "export-mcap": import_exported("mcap", "kept.mcap"),
    "known-machines": read_known_machines,
    "sealed": read_sealed,
    "pairing": read_pairing_word,
    "app-phone": read_app_phone,
}
"""By name; the corpus of each is `corpus/NAME`."""
