"""The formats that a session can be exported to."""

FORMATS = {
    "colmap": "images and rig_config.json; a model where calibrated",
    "nerfstudio": "transforms.json with the time of every image",
    "n3dv": "Neural 3D Video, 4DGaussians: camNN.mp4, poses, points",
    "easyvolcap": "EasyVolcap: images, intri.yml and extri.yml",
    "easymocap": "EasyMocap: videos, intri.yml and extri.yml",
    "freemocap": "synchronized_videos and the camera calibration",
    "caliscope": "recordings, timestamps.csv and camera_array.toml",
    "pose2sim": "a trial: videos and calibration/Calib.toml",
    "mcap": "one .mcap for Foxglove and Rerun",
    "mp4": "a video of each camera with its exact timestamps",
    "rrd": "one .rrd for Rerun",
}
"""Names as typed after --to; each is the name of a module here with a function `write`."""
