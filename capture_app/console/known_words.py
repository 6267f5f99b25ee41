"""Words that people know from other programs, and the command or option of ours that each one means.

They are ffmpeg's, git's, docker's, OpenCV's, COLMAP's, nerfstudio's and camera apps'.
"""

import os
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise, takewhile
from pathlib import Path

import click

from capture_app.common.names import FOOTAGE, IMAGE_SUFFIXES

OVERVIEW = (
    ". There are capture-app rig start, burst and record; capture-app sessions import FOLDER, list, show, "
    "note and export; reconstruct calibrate, time, multiview, people, view and splat SESSION"
)
"""What the answer to an unknown command shows."""
_COMMANDS = {
    "capture-app": {
        "capture-app status --watch": "follow tail logs-f log-f logs-follow",
        "capture-app rig list": "ps rigs log logs logcat container containers process processes events "
        "journal dmesg",
        "capture-app burst": "capture shoot take snap photo picture snapshot shot trigger frames grab "
        "fire still stills getsnapshot imwrite screencap release photograph screenshot capture-image "
        "capture-photo capture-still capture-frame capture-frames jpeg jpg raw shots bulb photos "
        "foto fotos bild fotografia capture-pictures selfie click pic pics snap-photo expose",
        "capture-app burst --name NAME, or record --name NAME": "new create create-session new-session "
        "project branch new-take",
        "capture-app burst --interval-s S": "timelapse time-lapse interval intervalometer shoot-interval "
        "capture-interval every",
        "capture-app burst --on-motion": "motion motion-detection watch-trigger wait-event event pir "
        "motion-trigger",
        "capture-app record": "mp4 mov mkv avi video film movie rec recording grab-video capture-video vid "
        "vids screenrecord screencast camcorder videowriter video-writer capture-movie capture-film recorder "
        "rec-video cam-record roll clip-record grabar aufnahme aufnehmen enregistrer gravar make-video",
        "capture-app record --stop": "end-recording stop-recording pause stop-record end-record stop-capture "
        "cut-recording finish",
        "capture-app rig start": "start up run launch init startup boot begin apply-rig deploy deployment "
        "create-rig serve-start daemon",
        "capture-app rig stop": "stop stop-all down quit kill shutdown end halt terminate teardown shut-down "
        "poweroff exit-rig stop-server kill-server exit close taskkill",
        "capture-app, without a command": "ui tui gui screen app open studio shell console interactive obs "
        "start-ui window desktop bash menu wizard interface attach-screen",
        "capture-app serve": "web browser",
        "capture-app leader": "server master host main controller serve-rig hub coordinator primary "
        "sync-server master-clock controller-start",
        "capture-app node --camera SPEC": "client slave join connect worker agent attach tether tethered "
        "videocapture videostream video-stream capture-device listen subscribe add-node join-rig connect-to "
        "daemon-node agent-start ssh run-node start-node",
        "capture-app cameras": "devices list-devices list-cameras webcam webcams ls-cameras scan discover "
        "sources source input inputs videoinput auto-detect autodetect detect imaqhwinfo dshow avfoundation "
        "v4l2 v4l lsusb enumerate list-sources cam cams usb usb-cameras root-hub lsdev probe-cameras find "
        "find-cameras available input-devices hardware list-ports usb-ports list-inputs list-formats-ext "
        "framesizes frame-sizes list-framesizes list-frameintervals sensors sensor scan-network "
        "find-devices",
        "capture-app cameras add SPEC": "add-camera addcamera add add-source add-device add-input "
        "create-input source-add",
        "capture-app node --camera SPEC,fps=N,width=W": "fps framerate resolution mode format size width "
        "height frame-rate parm set-fmt-video pixel-format pixelformat get-fmt-video fmt pixfmt pix-fmt "
        "camera-size r rate hz 4k 1080p 720p hd uhd rotate flip roi bitdepth pixel aspect",
        "capture-app trust pair LEADER": "pair login auth key keys register enroll enrol authorize authorise "
        "authenticate remote-add",
        "capture-app sessions list": "ls list takes pull yesterday library images files gallery log history "
        "lsl lsf lsd lsjson tree sessions-list dir catalog archive-list db database show-all l take-list "
        "recordings-list index where where-videos my-videos results see-results",
        "capture-app sessions trash SESSION": "delete rm remove del rmi trash unlink erase destroy drop "
        "discard rmdir",
        "capture-app sessions export SESSION": "convert save archive copy cp backup upload download push "
        "extract extract-frames mux converter clone export copyto copy-to moveto save-as dump rsync scp "
        "send transfer get-file get-all-files render-video",
        "capture-app sessions note SESSION TEXT": "tag annotate comment commit label note rate star favorite "
        "favourite memo",
        "capture-app sessions export SESSION --to otio": "edl xml fcpxml timeline premiere resolve davinci "
        "nle",
        "capture-app sessions export SESSION --to mcap": "rosbag ros2bag bag ros",
        "capture-app sessions export SESSION --to mp4": "mp4 mov prores encode transcode codec vcodec crf "
        "bitrate encoder mkv avi h264 remux",
        "capture-app sessions restore SESSION": "undo undelete untrash revert restore recover-deleted "
        "rollback reset-take undelete-take",
        "capture-app sessions import SOURCE": "footage gopro ingest dji multicam clips sync synchronize "
        "align load fetch merge concat process-data ns-process-data import-videos open-video "
        "extract-frames join-videos hstack vstack add-videos add-new-videos import pull-video "
        "download-footage add-footage open-folder multicam-sync align-videos sync-audio stitch-videos "
        "input-files convert-video put-together together combine sincronizar synchroniser synchronisieren",
        "capture-app sessions sheet SESSION": "contact-sheet thumbnails sheet view-pictures see-pictures "
        "show-pictures view-photos see-photos show-photos slideshow",
        "capture-app demo": "simulate sim simulated simulation fake virtual hello test-pattern testsrc "
        "example test-source mock dry-run tutorial quickstart getting-started try samples get-started "
        "without-cameras practice learn",
        "capture-app sessions show SESSION": "inspect describe probe info details metadata timestamps "
        "checkout ffprobe summary size mediainfo exif exiftool properties show stat cat head about size-of "
        "identify show-recording show-video play-recording see-result",
        "capture-app sessions verify SESSION": "check verify validate fsck cryptcheck checksum md5sum sha256 "
        "hashsum integrity",
        "capture-app sessions wiggle SESSION": "play replay wiggle gif animate animation boomerang loop",
        "capture-app sessions empty-trash": "purge clean empty-trash prune",
        "capture-app status": "cameras-sync sync-check sync-status test-sync sync-test nodes info stats "
        "state health sync synchronize genlock jam jam-sync accuracy clock latency dropped drops top ping "
        "pods node-status check-sync check-synchronization cluster cluster-info topic topics heartbeat echo "
        "hz state-of ready readiness sync-state drift jitter bandwidth monitor-status get-state health-check "
        "healthcheck",
        "capture-app doctor": "check diagnose test disk card space storage du firewall network wifi "
        "troubleshoot debug self-test selftest lint env environment system-info sysinfo about-system "
        "check-install battery temperature power usage gpu cpu memory permissions driver drivers ncdu df "
        "error errors problem broken work not-work not-found no-camera",
        "capture-app, by the line that installed it (docs/install.md)": "update upgrade install",
        "capture-app, by make uninstall or pip uninstall simulshot": "uninstall",
        "capture-app phones": "phone mobile android ios qr join-qr pair-qr iphone ipad smartphone tablet apk "
        "scan-qr",
        "capture-app monitor": "dashboard live watch stream livestream broadcast streaming stream-on "
        "view-live liveview live-view hls preview-all viewfinder multiview-live mirror watch-live rtmp "
        "broadcast-start",
        "capture-app --version": "version",
        "capture-app --help": "help man manual usage commands docs documentation explain ? ayuda aide hilfe",
        "capture-app people": "osc vmc live-people livemocap live-mocap avatar vtuber live-pose "
        "realtime-mocap",
        "reconstruct calibrate SESSION": "calibrate calibration calib intrinsics extrinsics lens lenses "
        "hand-eye calibrator camera-calibration camera-calibrator chessboard-calibrate "
        "calibrate-camera calibrate-intrinsics stereo-calibrate poses-calibrate wand kalibr",
        "reconstruct, a command of its own": "reconstruct",
        "reconstruct multiview SESSION --out DIR": "photogrammetry depth depthmap depth-map mesh pointcloud "
        "3d multiview sfm mvs volumetric ply scan obj model dense build reconstruct-3d point-clouds "
        "dense-cloud tsdf nerf-to-mesh colmap-dense reconstruct-mesh voxel voxels kinect rgbd tof",
        "reconstruct stereo SESSION --out DIR": "stereo disparity",
        "reconstruct splat SESSION --out DIR": "splat splats gsplat gaussians gaussian-splat "
        "gaussian-splatting train 3dgs nerf nerfacto splatfacto",
        "reconstruct trajectory SESSION --out DIR": "track trajectory tracking track-object ball track-ball "
        "object-tracking",
        "reconstruct panorama SESSION --out DIR": "panorama stitch pano 360",
        "reconstruct people SESSION --out DIR": "gait angles pose2d pose3d markerless pose poses skeleton "
        "mocap joints keypoints triangulate c3d bvh trc blender freemocap mediapipe openpose opencap "
        "deeplabcut dlc fbx motion-capture body-tracking estimate-pose track-people skeletons smpl face "
        "hands hand animal animals keypoint label label-videos pose-2d 3d-pose pose-3d",
        "reconstruct movers SESSION --out DIR": "matte mattes mask masks movers greenscreen green-screen "
        "chroma-key background background-removal segment",
        "reconstruct compare SESSION --out DIR": "compare evaluate report",
        "reconstruct time SESSION": "time offset offsets sync-offset time-offset clap flash latency-offset",
        "capture-app panel show": "timecode time-code led",
        "reconstruct board FILE": "make-board print-board board charuco chessboard checkerboard",
        "reconstruct view SESSION --out DIR": "orbit flythrough view walk render bullet-time bullettime "
        "freeze freeze-frame visualize visualise plot rviz novel-view",
        "reconstruct view SESSION --page --out DIR": "share publish viewer",
        "capture-app burst --before N": "replay-buffer instant-replay retroactive pre-roll preroll",
        "capture-app burst --wait-s S": "wait wait-for wait-for-device arm",
        "capture-app burst, after the shell's sleep 10": "countdown self-timer timer photobooth",
        "capture-app rig stop, then capture-app rig start": "restart reboot rollout reset reload",
        "capture-app rig stagger ORDER": "stagger offset-cameras interleave phase trigger-delay",
        "capture-app node --camera SPEC,sound=own": "sound audio mic microphone mute",
        "capture-app node --name NAME --camera SPEC": "rename-camera camera-name set-name alias label-node "
        "label-nodes label-pods rename-node",
        "capture-app leader --port PORT": "port ports tcpip",
        "capture-app cameras controls": "ctrl ctrls list-ctrls get-ctrl list-config config-list "
        "get-config list-controls capabilities abilities caps controls",
        "capture-app cameras match CAMERA": "match match-cameras",
        "capture-app cameras characterize SPEC": "characterize benchmark",
        "capture-app cameras calibrate-time": "calibrate-time delay delays lag measure-delay measure-latency",
        "capture-app cameras set exposure=4000, in µs": "exposure exposure-time exposure-absolute "
        "exposure-us shutter shutter-speed auto-exposure ae ev shutterspeed exposure-compensation aperture "
        "brightness light-meter meter",
        "capture-app cameras set gain=2": "gain iso analogue-gain gain-db isospeed analog-gain",
        "capture-app cameras set focus=auto": "focus autofocus auto-focus af focus-absolute zoom lens-focus",
        "capture-app cameras set white-balance=5000, in kelvin": "white-balance whitebalance wb awb "
        "color-temperature auto-white-balance colour color tint kelvin temperature-color saturation hue",
        "capture-app cameras set --profile FILE": "profile preset presets apply",
        "capture-app sessions import SOURCE --start N --count N": "trim cut crop clip",
        "capture-app sessions rename SESSION NAME": "mv rename move",
        "capture-app sessions repair SESSION": "repair recover resume salvage reindex rebuild fix finalize",
        "capture-app trust list": "trusted remotes known-hosts",
        "capture-app trust invite": "invite code token pin password otp",
        "capture-app trust remove MACHINE": "revoke forget untrust",
        "reconstruct compare SESSION --against OTHER --out DIR": "diff",
        "capture-app sessions schema": "schema",
        "capture-app cameras show NAME": "logcat topic-hz show camera-info get-camera "
        "device-info serial serialno get-serialno",
        "capture-app cameras list": "list",
        "capture-app cameras set CONTROL=VALUE, such as exposure=4000": "settings config controls set "
        "set-config set-ctrl param params property properties edit patch configure configuration adjust "
        "tune option options parameters",
        "capture-app preview CAMERA": "hello capture-preview preview-window image-view imageview open-camera "
        "open-webcam",
        "capture-app relay LEADER": "repeater bridge proxy forward tunnel",
        "capture-app leader --lsl": "lab-streaming-layer",
        "capture-app mark TEXT": "marker event-marker bookmark slate clapper clap",
        "capture-app refclock": "chrony ntp ptp",
        "capture-app cameras remove NAME": "kick eject disconnect drain detach unplug remove rm delete stop "
        "kill release-camera hide-source remove-source cordon evict delete-node remove-node",
        "capture-app burst --repeat N": "repeat replicas series hdr bracket bracketing sequence",
        "capture-app doctor --report FILE": "bugreport bug-report report-bug support-bundle bug",
        "capture-app rig start --camera SPEC": "scale multi multicamera multi-camera",
        "capture-app sessions export SESSION --to rrd": "rerun",
        "capture-app sessions export SESSION --to splats": "postshot",
        "capture-app panel read SESSION": "timecode-read read-panel",
        "capture-app coverage": "coverage-map board-coverage live-calibration",
        "capture-app record --fps N": "slow-motion slowmo slow-mo high-speed highspeed hfr slow-video",
        "capture-app record --seconds S": "t seconds minutes duration length",
    },
    "capture-app sessions": {
        "capture-app sessions trash SESSION": "delete rm remove del purge",
        "capture-app sessions list": "ls dir",
        "capture-app sessions show SESSION": "info inspect describe open details metadata size du stat stats "
        "cat status timecode time-code",
        "capture-app sessions rename SESSION NAME": "mv move name label",
        "capture-app sessions verify SESSION": "check validate fsck",
        "capture-app sessions repair SESSION": "fix recover resume",
        "capture-app sessions export SESSION": "convert save to copy cp upload backup download share push "
        "pull get fetch",
        "capture-app sessions import SOURCE": "add load read from merge combine concat new-from",
        "capture-app sessions note SESSION TEXT": "annotate comment tag rate star edit describe-as",
        "capture-app sessions restore SESSION": "undelete undo untrash",
        "capture-app sessions sheet SESSION": "contact-sheet thumbnails preview grid index",
        "capture-app sessions wiggle SESSION": "play replay view gif animate preview-video watch",
        "capture-app sessions empty-trash": "clean prune empty",
        "reconstruct time SESSION": "sync synchronize align time offset",
        "reconstruct view SESSION --out DIR": "render",
        "reconstruct calibrate SESSION": "calibrate",
        "reconstruct multiview SESSION --out DIR": "reconstruct process",
        "capture-app burst --name NAME, or record --name NAME": "new create start init",
        "capture-app doctor": "disk",
    },
    "reconstruct": {
        "reconstruct multiview SESSION --out DIR": "photogrammetry depth depthmap dense mvs pointcloud "
        "point-cloud cloud fusion 3d volumetric scan obj model patch-match-stereo stereo-fusion "
        "automatic-reconstructor delaunay-mesher reconstruct reconstruction rebuild tsdf voxel build "
        "model-converter run pipeline run-pipeline start create make texture texturer mesh-texturer "
        "texrecon meshing meshroom odm mvsnet cloudcompare dust3r vggt 3d-model pcshow pcd openmvs "
        "reconstruction-3d dense-reconstruction fuse fused tsdf-fusion poisson-recon depth-fusion "
        "depthanything midas",
        "reconstruct multiview SESSION --mesh --out DIR": "blend glb gltf mesh poisson mesher poisson-mesher",
        "reconstruct multiview SESSION --instant N --out DIR": "frame frames instant moment",
        "reconstruct stereo SESSION --out DIR": "disparity sgbm pair rectify stereo-image-proc bm depth-pair "
        "stereo-match",
        "reconstruct calibrate SESSION --mark CAMERA=X,Y --distance-m M": "scale align-gcp gcp height",
        "reconstruct view SESSION --page --out DIR": "share",
        "reconstruct calibrate SESSION": "sfm sparse mapper calib calibration intrinsics extrinsics poses "
        "colmap feature-extractor exhaustive-matcher sequential-matcher bundle-adjuster "
        "matcher global-mapper point-triangulator triangulator database database-creator aligner "
        "model-aligner configurator rig-configurator calibrator camera-calibration solve slam "
        "camera-solve camera-track matchmove estimate parameters bundle adjuster rig-bundle-adjuster "
        "calibrate-intrinsics calibrate-extrinsics calibrate-camera intrinsic extrinsic vocab-tree-matcher "
        "analyzer model-analyzer register image-registrator align-cameras poses-calibrate stereo-calibrate "
        "transform scale-model hloc superglue glomap detect detect-board detect-markers aruco reprojection "
        "reprojection-error residuals color-extractor spatial rig sift features matching matches "
        "keypoints-match hand-eye odometry vo vio camera-model camera-params essential fundamental "
        "homography pnp solvepnp camera-info kalibr",
        "reconstruct splat SESSION --out DIR": "ns-export splats gsplat gaussian gaussians gaussian-splat "
        "gaussian-splatting splatfacto train 3dgs nerf nerfacto ngp instant-ngp gs gsplats "
        "radiance-field fit optimize optimise neus gsplat-train supersplat brush postshot 3d-gaussians "
        "mip-nerf zipnerf tensorf",
        "reconstruct panorama SESSION --out DIR": "stitch pano stitching 360 equirectangular mosaic stitcher "
        "180",
        "reconstruct view SESSION --out DIR": "orbit flythrough walk play render novel-view bullet-time "
        "bullettime wiggle viewer visualize visualise visualization rviz viz plot display rendering "
        "animate animation render-video turntable interpolate slerp fly viser render-anim "
        "render-output open3d meshlab gif film movie mp4 webp",
        "reconstruct time SESSION": "sync synchronize align offset offsets synchronise time-sync genlock "
        "audio-sync",
        "reconstruct people SESSION --smooth 6 --out DIR": "butterworth lowpass low-pass cutoff",
        "reconstruct people SESSION --keypoints FOLDER --out DIR": "labels points import-keypoints "
        "import-labels load-keypoints load-labels",
        "reconstruct people SESSION --out DIR": "gait angles pose2d pose3d markerless pose skeleton mocap "
        "joints keypoints motion-capture human body triangulate c3d bvh trc freemocap mediapipe openpose "
        "opencap anipose deeplabcut dlc fbx label labeled label-3d filter filter-3d filterpredictions "
        "analyze analyse predict inference smpl smooth process process-recording process-session project-2d "
        "reproject estimate-pose pose-estimation estimate track-people lift lift-3d dance walk-cycle "
        "retarget rig-animation vicon opensim bodies person humans kinematics detections detection "
        "create-video-with-all-detections label-2d pose-2d triangulate-3d inverse-kinematics ik "
        "gait-analysis yolo rtmpose vitpose hrnet alphapose sleap smplx 3d-pose pose-3d 3d-skeleton",
        "reconstruct movers SESSION --out DIR": "matte mattes mask masks segment rotoscope greenscreen "
        "green-screen background background-removal foreground matting segmentation remove-background "
        "roto sam mask-out silhouettes silhouette",
        "reconstruct trajectory SESSION --out DIR": "track ball path tracking tracker camera-tracker object "
        "track-object motion",
        "reconstruct compare SESSION --out DIR": "evaluate eval report summarize summary psnr ssim "
        "benchmark benchmarks metrics validate score stats check verify error errors quality-check "
        "accuracy",
        "reconstruct board FILE": "make-board print-board charuco chessboard checkerboard",
        "reconstruct batch SESSIONS": "jobs slurm",
        "capture-app sessions import SOURCE": "import images photos pictures image-path process-data "
        "ns-process-data convert-videos load ingest data input extract-frames folder footage clips "
        "add-videos add-new-videos download download-data dataset project new-project init open add",
        "capture-app sessions export SESSION": "export convert converter model-converter ns-export save "
        "extract-frames output",
        "capture-app sessions list": "list ls sessions",
        "capture-app sessions show SESSION": "show info describe inspect",
        "capture-app burst": "capture shoot burst",
        "capture-app record": "record video",
        "reconstruct --version": "version",
        "reconstruct --help": "help config toml options",
        "capture-app sessions trash SESSION": "delete rm remove",
        "capture-app cameras": "cameras devices",
        "capture-app, without a command": "gui ui tui start-ui visualizer-app",
        "capture-app panel show": "timecode",
        "reconstruct compare SESSION --against OTHER --out DIR": "diff",
        "capture-app doctor": "doctor test gpu cuda check-install bugreport",
        "capture-app status": "status",
        "capture-app demo": "demo example simulate",
        "capture-app sessions repair SESSION": "repair recover",
        "reconstruct batch SESSIONS --out DIR": "queue submit sbatch cluster",
    },
    "capture-app cameras": {
        "capture-app cameras list": "ls devices scan discover find",
        "capture-app cameras show NAME": "info get inspect",
        "capture-app cameras remove NAME": "rm delete del disconnect stop disable close off eject kick",
        "capture-app cameras add SPEC": "open connect new attach start run enable on",
        "capture-app cameras controls": "list-formats formats list-controls ctrls",
        "capture-app cameras set CONTROL=VALUE, such as exposure=4000": "config settings control",
        "capture-app cameras set exposure=4000, in µs": "exposure shutter",
        "capture-app cameras set gain=2": "gain iso",
        "capture-app cameras set focus=auto": "focus autofocus",
        "capture-app node --name NAME --camera SPEC": "rename name label",
        "capture-app preview CAMERA": "preview view look",
        "capture-app doctor": "test check",
        "capture-app cameras characterize SPEC": "measure benchmark profile-camera",
        "capture-app cameras set white-balance=5000, in kelvin": "white-balance wb awb",
        "capture-app node --camera SPEC,fps=N,width=W": "fps framerate resolution size mode format width "
        "height",
        "capture-app status": "sync status state",
        "capture-app cameras calibrate-time": "delay latency offset",
    },
    "capture-app rig": {
        "capture-app rig stop": "down kill quit end",
        "capture-app record": "record video film rec",
        "capture-app burst": "burst capture shoot take photo",
        "capture-app rig start": "up run launch new create init",
        "capture-app status": "status state info sync check nodes show",
        "capture-app rig list": "ls ps show status-all",
        "capture-app cameras add SPEC, or capture-app node on another machine": "add connect",
        "capture-app cameras remove NAME": "remove",
        "capture-app rig stop, then capture-app rig start": "restart reset reboot",
        "capture-app preview CAMERA": "preview",
        "capture-app sessions list": "sessions takes",
        "capture-app cameras": "cameras devices",
        "capture-app monitor": "view watch monitor live",
        "capture-app cameras set CONTROL=VALUE, such as exposure=4000": "set config settings",
        "reconstruct calibrate SESSION": "calibrate",
    },
    "capture-app trust": {
        "capture-app trust list": "ls show status info",
        "capture-app trust pair LEADER": "join connect login accept approve add-machine connect-to",
        "capture-app trust remove MACHINE": "rm delete del revoke forget",
        "capture-app trust invite": "code qr new create generate share",
    },
}
"""Command lines by the group that was typed, with the words that mean them."""
FORMATS = {
    "otio": "premiere premiere-pro adobe resolve davinci davinci-resolve final-cut final-cut-pro fcp fcpx "
    "fcpxml xml edl aaf avid kdenlive hiero editor nle timeline",
    "splats": "undistort undistorted image-undistorter pinhole blender gltf 3dgs gsplat "
    "gaussian-splatting gaussians inria postshot brush",
    "nerfstudio": "ns-process-data process-data instant-ngp ngp nerf transforms",
    "colmap": "metashape agisoft realitycapture realityscan openmvs",
    "caliscope": "anipose",
    "pose2sim": "opensim mocap",
    "mcap": "foxglove ros ros2 rosbag rosbag2 ros2bag bag",
    "rrd": "rerun",
    "mp4": "video videos film movie h264 h265 hevc mov prores avi mkv webm after-effects aftereffects ae "
    "nuke fusion unreal unity",
}
"""Formats of `sessions export`, each with the programs that read it and other words for it."""
RESULTS = {
    "reconstruct people SESSION --out DIR": "c3d trc skeleton fbx bvh",
    "reconstruct multiview SESSION --out DIR": "ply las laz e57 obj pointcloud point-cloud mesh glb",
    "reconstruct movers SESSION --out DIR": "matte mattes mask masks",
}
"""Commands whose results people look for among the formats of an export, with words for them."""
_ACTIONS = {
    "capture-app theme": "dark light colour colours color colors night contrast appearance",
    "capture-app rig add": "webcam webcams usb device devices simulated simulate sim node connect",
    "capture-app rig board": "board charuco chessboard checkerboard print-board pdf paper",
    "capture-app cameras add": "rtsp ip-camera ip-cameras ipcam onvif network-camera cctv",
    "capture-app shoot live-people": "mocap joints skeleton",
    "capture-app app quit": "exit close leave",
    "capture-app app help": "keys shortcuts",
    "capture-app cameras set": "shutter iso lock-exposure",
    "capture-app node fps": "fps frame-rate framerate rate hz",
    "capture-app sessions empty-trash": "disk space storage size free",
    "capture-app sessions look": "disk storage size",
    "capture-app sessions sort": "two-takes compare-takes best rank order size largest disk storage du",
    "capture-app sessions import": "sound audio timecode",
    "capture-app rig remove": "kill stop-camera",
}
"""Actions of the screen that are not commands, written as if they were, with other words for them."""
_OPTIONS = {
    "--frames": "count n num number num-frames shots images photos pictures vframes F number-of-frames limit",
    "--count": "n num frames number max-frames vframes",
    "--out": "output o out-dir output-dir output-path dir dest destination outfile workspace-path to "
    "export-dir save save-path write-to output-file",
    "--to": "format f type output-format as",
    "--seconds": "duration t time length for hours minutes time-limit timeout seconds-long duration-s "
    "timeout-s stop-after record-time",
    "--interval-s": "interval timelapse I",
    "--fps": "rate framerate frame-rate r hz video-fps capture-rate",
    "--camera": "device source src input i cam spec cameras d dev device-id index c cameras-list "
    "input-device video",
    "--leader": "server host address ip connect url leader-address master hub remote h",
    "--sessions": "dir folder out output data output-dir save-dir storage path",
    "--name": "label title tag n O session take filename prefix file-name",
    "--json": "output-json as-json machine o-json pretty",
    "--port": "p listen listen-port tcp-port",
    "--host": "bind address ip listen",
    "--instant": "frame frames index at time timestamp frame-index start",
    "--instants": "frames range",
    "--width": "size resolution scale res max-size image-size size-px downscale",
    "--cameras": "count n num devices",
    "--simulated": "fake sim dummy",
    "--replace": "overwrite force f y overwrite-output",
    "--yes": "y force",
    "--jobs": "j threads workers parallel num-workers",
    "--from": "method mode using",
    "--square-mm": "square square-size square-length size charuco-square-size checker-size",
    "--marker-mm": "marker marker-size marker-length",
    "--watch": "follow f w",
    "--stop": "end finish",
    "--detach": "d background daemon",
    "--min-nodes": "min-cameras nodes cameras",
    "--quick": "fast preview draft quality low draft-mode",
    "--mesh": "poisson glb gltf obj",
    "--iterations": "steps iters max-iterations",
    "--verbose": "debug trace log-level",
    "--keypoints": "dlc deeplabcut openpose sleap mmpose alphapose coco",
    "--calibration": "intrinsics camera-params calib",
    "--every": "step stride skip",
    "--field-of-view": "fov hfov",
    "--to otio": "premiere resolve davinci edl fcpxml",
    "--to mp4": "codec mp4 video prores",
    "--align": "sync audio by",
    "--page": "paper",
    "--wait-s": "timeout wait",
    "--masks": "mask",
    "--lens": "camera-model model distortion",
    "--spz": "compress",
}
"""Options, each with other programs' words for it, without hyphens; the first that a command has wins."""
_SIMULATED = {"--camera sim:phone-a": "simulated simulate sim simulation fake dummy virtual"}
_OF_A_RIG = {
    "capture-app rig start --sessions DIR": "o out output output-dir outdir dir folder path dest",
    "capture-app rig start --camera SPEC": "i camera cameras cam device source src input",
}
_OPTIONS_OF = {
    "capture-app burst": {**_OF_A_RIG, "--frames": "duration length seconds t time"},
    "capture-app record": {
        "capture-app sessions export SESSION --to mp4": "mp4 mov mkv avi f format codec vcodec crf bitrate "
        "container preset",
        **_OF_A_RIG,
    },
    "capture-app leader": {"--host": "ip bind address listen"},
    "reconstruct board": {"--board": "size rows cols columns grid squares pattern"},
    "reconstruct calibrate": {
        "--board": "charuco chessboard checkerboard squares pattern size rows cols columns cbrow cbcol grid",
        "--mark CAMERA=X,Y --distance-m M": "gcp scale",
    },
    "reconstruct multiview": {"--out DIR, with a PLY in it": "format ply las"},
    **dict.fromkeys(("capture-app", "capture-app node", "capture-app rig start"), _SIMULATED),
    "reconstruct people": {
        "--out DIR, with CSV, TRC, C3D and glTF in it": "c3d trc csv gltf glb fbx bvh format",
        "--rate": "fps framerate",
    },
    "capture-app sessions export": {
        **{f"--to {name}": f"{name} {words}" for name, words in FORMATS.items()},
        "in each export, as frames.csv": "csv",
        **{line: " ".join(f"format-{word}" for word in words.split()) for line, words in RESULTS.items()},
    },
}
"""Options that mean this of certain commands alone, in the same form."""
_SHAPES = {
    r"/dev/video\d+": "capture-app node --camera v4l2:{}, or capture-app cameras",
    r"video\d+": "capture-app node --camera v4l2:/dev/{}, or capture-app cameras",
    r"\d": "capture-app node --camera webcam:{}, or capture-app cameras",
    r"(?:rtsps?://|(?:v4l2|webcam|sim|libcamera|aravis|replay):).+": "capture-app node --camera {}",
    r"\d+(?:\.\d+){3}(?::\d+)?": "--leader {0}, or capture-app trust pair {0}",
    r"1/\d+": "capture-app cameras set exposure=4000, in µs",
    r"(\d+(fps|hz)|\d{3,5}x\d{3,5})": "capture-app node --camera SPEC,fps=N,width=W",
}
"""What a word means by its shape: a camera, the address of a leader, or a size."""
_WEAK, _FILLERS = (
    {*words.split()}
    for words in (
        "adb add all begin camera colmap connect convert create data do export ffmpeg file finish "
        "format get join list make new obs open out output path python run save see session set show "
        "start take to use view",
        "a an are by can do for from how i in is it last me my not of on our please the this to two "
        "want with your",
    )
)
"""Words that say less than the others of a line, as in `list-devices`, and those that say nothing."""
_SOURCES = ("capture-app burst", "capture-app record", "capture-app node", "capture-app preview")
"""Commands that make footage: a file that is named beside them is not imported first."""
_MODELS = (".glb", ".gltf", ".obj", ".ply", ".usdz")
_OF_A_SESSION = {
    "reconstruct": "reconstruct multiview SESSION --out DIR",
    "capture-app": "capture-app sessions show SESSION",
}
"""What a session in place of a command means where no other word of the line says it."""
_NUMBERS = {
    "integer": "a whole number",
    "integer range": "a whole number",
    "float": "a number",
    "float range": "a number",
}
"""What an option of a type takes, by click's name of the type."""
_LISTS = {
    "--camera": "capture-app cameras lists what there is",
    "CAMERA": "capture-app status names those of the rig",
    "SESSION": "capture-app sessions list shows what is there",
}
"""Commands that list the values of an option or argument."""
_PART = re.compile("[0-9]*[A-Z]?[a-z][a-z0-9]*|[A-Z]+(?![a-z])")
_UNITS = [
    {unit: factor for units, factor in kind.items() for unit in units.split()}
    for kind in (
        {
            "us": 1e-6,
            "ms": 1e-3,
            "s sec secs second seconds": 1,
            "min mins minute minutes": 60,
            "h hour hours": 3600,
        },
        {"mm": 1, "cm": 10},
        {"fps hz rate": 1},
    )
]
"""Units of time, length and rate, which people write after a number and our options have in their names."""
_NUMBER = re.compile(r"\d+|\d*:[\d:.]+|\d*\.\d+")
"""A number or a time, which alone means nothing."""
_ENDING = re.compile("(?<=...)(ations?|at(e[sd]?|ing)|ings?|ed|es?|s)$")
_TOO_MANY = re.compile(r"Got unexpected extra arguments? \((.*)\)", re.DOTALL)
_CLOSE = 0.75
"""Similarity from which a name counts as mistyped; click's own 0.6 takes `--json` for `--count`."""
_MAX_LETTERS, _MAX_WORDS = 40, 50
"""Letters of a word that are taken apart, and words of a line that are asked."""
_EXPORTS = {f"capture-app sessions export SESSION --to {name}": f"{name} {FORMATS[name]}" for name in FORMATS}


def words_for(line: str) -> list[str]:
    """Return other programs' words for a command line, given without its arguments, or its binding."""
    return " ".join(
        [
            *(
                words
                for rows in (*_COMMANDS.values(), _ACTIONS)
                for meant, words in rows.items()
                if f"{meant} ".startswith(f"{line.replace('.', ' ')} ")
            ),
            FORMATS.get(line.rpartition(" --to ")[2], ""),
        ]
    ).split()


class _Tables:
    """Command lines by the words that mean them, in tables of which the first that has a word decides."""

    def __init__(self, *tables: Mapping[str, str]) -> None:
        self._tables = [{line: {*map(_plain, rows[line].split())} for line in rows} for rows in tables]

    def lines(self, word: str) -> list[str]:
        """Return what a whole word means."""
        answers = ([line for line in rows if _plain(word) in rows[line]] for rows in self._tables)
        return next(filter(None, answers), _shaped(word))

    def meanings(self, word: str) -> dict[str, float]:
        """Return lines and weights of a word, or of the parts of `take-photo`, `takePhoto` or `takephoto`."""
        if lines := self.lines(word):
            return dict.fromkeys(lines, _weight(word))
        # Of a file's name, the ending says what it holds, and of a path nothing else does.
        *path, name = re.split(r"[/\\]", word)
        ending = name.rpartition(".")[2]
        pieces = [ending] if path or self.lines(ending) else re.findall("[^.()]{2,}", name[:_MAX_LETTERS])
        parts = [
            part for piece in pieces for part in [piece] * bool(self.lines(piece)) or _PART.findall(piece)
        ]
        # A part that says little does not replace one that says more.
        known = sorted((word for part in parts for word in self._cut(part)), key=_weight)
        return {line: _weight(word) / 2 for word in known for line in self.lines(word)}

    def _cut(self, part: str) -> list[str]:
        """Return a known part, or the two known words of which it is; nothing for others."""
        cuts = ([part[:at], part[at:]] for at in range(3, len(part) - 2))
        return next((cut for cut in ([part], *cuts) if all(map(self.lines, cut))), [])

    def ranked(self, words: Sequence[str]) -> list[str]:
        """Return what the words of a line mean together, the likeliest first."""
        scores: dict[str, float] = {}
        for word, after in pairwise((*(word for word in words if word.casefold() not in _FILLERS), "")):
            # Of two words, such as `grab video`, both together decide.
            both = self.lines(word + after.lstrip("-")) if after else ()
            known = {**self.meanings(word), **dict.fromkeys(both, 2.0)}
            if word[:1] == "-" and word != words[0]:
                # Docker's `run --rm` deletes no take.
                known = {line: weight for line, weight in known.items() if " trash " not in line}
            # What stands first says more than what follows, unless it says little.
            known = known if scores else {line: weight + (weight >= 0.5) for line, weight in known.items()}
            scores.update({line: scores.get(line, 0) + weight for line, weight in known.items()})
        # Who says more asks for the line that says more: `burst --on-motion` is a burst.
        sums = {
            line: sum(
                score
                for other, score in scores.items()
                if f"{line} ".startswith(f"{other.removesuffix(' --out DIR')} ")
            )
            for line in scores
        }
        # Of two meanings, `info take1` is about a session, `info` about the rig.
        order = sorted(
            sums, key=lambda line: (-sums[line], line.split(" -")[0][-1:].isupper() is not (len(words) > 1))
        )
        return [line for line in order if sums[line] >= 0.3 * sums[order[0]]]


def _weight(word: str) -> float:
    """Return how much a word says: an option less than a word, and `open` or `camera` least."""
    return 0.3 if _plain(word) in map(_plain, _WEAK) else 1 if word[:1] != "-" else 0.6


def _plain(word: str) -> str:
    """Return a word as it is looked up: without a value, hyphens, capitals and ending."""
    # One letter means two things, as gphoto2's -i and -I.
    plain = re.sub("^/|[-_]|[?!.,]$", "", word.partition("=")[0])
    return _ENDING.sub("", plain.casefold()) if len(plain) > 1 else plain


def _shaped(word: str) -> list[str]:
    """Return what a word means by its shape."""
    shaped = [lines for shape, lines in _SHAPES.items() if re.fullmatch(shape, word)]
    return [line.format(word) for lines in shaped for line in lines.split(", or ")]


def advise(error: click.UsageError, typed_line: Sequence[str] = ()) -> str:
    """Return the message of a usage error, with what was probably meant by the words of the line."""
    path, names = (error.ctx.command_path, _names(error.ctx)) if error.ctx else ("", [])
    ours = path.split()
    named = [(a, word) for a, word in pairwise(("", *typed_line)) if word[:1] != "-" and word not in ours]
    models = [word for before, word in named if word.casefold().endswith(_MODELS) and before[:1] != "-"]
    if models and isinstance(error, click.MissingParameter | click.NoSuchCommand):
        return f"'{models[0]}' is a 3D model: Blender shows it, and reconstruct view shows sessions"
    files = [word for before, word in named if before[:2] != "-o" != before[1:3] and _is_footage(word)]
    # Beside what is there, other names are outputs.
    files = [*filter(os.path.lexists, files)] or files
    footage = " ".join(files[:3] + ["..."] * (len(files) > 3))
    extra = _TOO_MANY.fullmatch(error.message.rstrip("."))
    if error.ctx is None or not (extra or isinstance(error, click.NoSuchOption | click.NoSuchCommand)):
        return _in_our_words(error, typed_line)
    session = next(filter(None, map(_session_at, typed_line[:_MAX_WORDS])), "")
    own, every = _tables(error, error.ctx, has_session=bool(names and session))
    if place := _at_place(error, error.ctx, typed_line, footage, every):
        return place
    unknown, typed = _unknown(error, extra[1] if extra else "", typed_line)
    if extra and not footage and (option := _option_for(extra[1], error.ctx)):
        return f"{unknown} ({option})"
    split = (word.split("=", 1) if word[:2] == "--" else [word] for word in typed_line[:_MAX_WORDS])
    words = [word for parts in split for word in parts if not _NUMBER.fullmatch(word)]
    at = words.index(typed) if typed in words else len(words)
    after, before = words[at + 1 :], [word for word in words[:at] if word not in ours]
    near = names if isinstance(error, click.NoSuchCommand) else _options(error.ctx)
    known = own.lines(typed) or (own.lines(typed + after[0].lstrip("-")) if after else [])
    more = [
        f"{word} is {(*every.ranked([word]), 'unknown, too')[0]}"
        for word in after
        if isinstance(error, click.NoSuchOption) and word[:1] == "-" and word not in (*near, typed)
    ]
    close = get_close_matches(typed.casefold(), near, 1, _CLOSE)
    if close and ((not after and _plain(close[0]) == _plain(typed)) or not (known or _weight(typed) < 0.5)):
        return "; ".join((f"{unknown}. Did you mean '{close[0]}'?", *more))
    # An option is asked with its value, and an unknown command with all words of the line.
    value = [word for word in after[:1] if word[:1] != "-"]
    others = [word for word in (*after, *before) if not (word in files or os.path.lexists(word))]
    asked = [typed, *([*others, *["footage"][: len(files)]] if names else value)]
    places = {"SOURCE": footage, "SESSION": session}
    ranked = every.ranked(asked) or [_OF_A_SESSION[path.split()[0]]] * bool(session and names)
    # What was typed is not an answer.
    shown = [
        _whole(
            " ".join((re.sub("SOURCE|SESSION", lambda place: places[place[0]] or place[0], line), *number))
        )
        for line in ranked
        for number in [[*filter(None, (_in_unit(word, line) for word in value))]]
        if line not in words and re.sub(" [A-Z].*", "", line) != path
    ][:3]
    answer = "; ".join((f"{unknown}: it is {', or '.join(shown)}" if shown else unknown, *more))
    is_source = (*shown, path)[0].startswith(_SOURCES)
    is_there = names and any(map(os.path.lexists, files))
    if footage and (is_there or not (known or is_source)) and " import" not in answer + path:
        return f"{answer}; footage is imported first: capture-app sessions import {footage}"
    if shown and (known or names or extra):
        return answer
    return answer + (OVERVIEW if error.ctx.parent is None else f"; {path} takes {_takes(error.ctx)}")


def _whole(line: str) -> str:
    """Return an export's line with the options without which it is refused."""
    return re.sub(
        r"(export [^ ,]+)( --to \S+)?$", lambda of: f"{of[1]}{of[2] or ' --to FORMAT'} --out DIR", line
    )


def _unknown(error: click.UsageError, extra: str, typed_line: Sequence[str]) -> tuple[str, str]:
    """Return what a message says first about a word, and the word."""
    if isinstance(error, click.NoSuchCommand):
        return f"No such command '{error.command_name}'", error.command_name
    if not isinstance(error, click.NoSuchOption):
        return f"too many arguments: {extra}", next((w for w in extra.split() if not w.isdecimal()), extra)
    typed = error.option_name
    # Of ffmpeg's `-vcodec`, click names one letter.
    clusters = (word for word in typed_line if "-" == word[:1] != word[1:2] and typed[1] in word)
    typed = next(clusters, typed) if len(typed) == 2 else typed
    return f"No such option '{typed}'", typed


def _tables(error: click.UsageError, ctx: click.Context, *, has_session: bool) -> tuple[_Tables, _Tables]:
    """Return the table of the command where a line ended, and all tables, the nearest first."""
    path, root, names, options = ctx.command_path, ctx.find_root(), _names(ctx), _options(ctx)
    known: Mapping[str, str] = {f"{path} {name} --help": f"help-{name}" for name in names}
    if not isinstance(error, click.NoSuchCommand):
        known = {line: words for line, words in _OPTIONS.items() if line.split()[0] in options}
        known = _OPTIONS_OF.get(path, {}) | known
        known |= {name: f"{name} {known.get(name, '')}" for name in options if name[:2] == "--"}
    ours = {f"{at.command_path} {name}": name for at in (ctx, root) for name in _names(at)}
    programs = [_COMMANDS.get(name, {}) for name in (root.command_path, "capture-app", "reconstruct")]
    own = {**known, **_COMMANDS.get(path, {})}
    of_session = "capture-app sessions" if has_session else ""
    every = (
        _COMMANDS.get(of_session, {}),
        own,
        ours,
        programs[0],
        _EXPORTS,
        *programs[1 : 3 if names else 1],
    )
    # A line about a session is not answered with what takes none.
    rows = ({line: of[line] for line in of if "SESSION" in line or not has_session} for of in every)
    return _Tables(own), _Tables(*rows)


def _names(ctx: click.Context) -> list[str]:
    return ctx.command.list_commands(ctx) if isinstance(ctx.command, click.Group) else []


def _options(ctx: click.Context) -> list[str]:
    return [name for param in ctx.command.get_params(ctx) for name in param.opts if name[:1] == "-"]


def _takes(ctx: click.Context) -> str:
    """Return what a command takes, in short: its commands, or its arguments and options."""
    taken = (
        param.opts[-1] if param.opts[0][:1] == "-" else param.make_metavar(ctx)
        for param in ctx.command.get_params(ctx)
    )
    return ", ".join(
        _names(ctx) or [name for name in taken if name not in ("--quiet", "--verbose", "--help")]
    )


def _at_place(
    error: click.UsageError, ctx: click.Context, typed_line: Sequence[str], footage: str, tables: _Tables
) -> str:
    """Return what to do with a file, a session or a folder in place of a command; empty for others."""
    word = error.command_name if isinstance(error, click.NoSuchCommand) else ""
    then = _OF_A_SESSION.get(ctx.find_root().command_path, "")
    if word.casefold().endswith(FOOTAGE):
        return f"'{word}' is a file: capture-app sessions import {footage or word} imports it, then {then}"
    # A program without a command is asked by all words of its line.
    words = [word] if word else typed_line[:_MAX_WORDS] if ctx.parent is None else []
    if session := next(filter(_session_at, words), ""):
        others = [other for other in typed_line[:_MAX_WORDS] if other != session]
        line = next((line for line in tables.ranked(others) if " SESSION" in line), then)
        line = line.replace("SESSION", _session_at(session))
        return f"'{session}' is a session; the command comes first: {line}{OVERVIEW}"
    if {"/", "\\"} & {*word} and not (tables.lines(word) or os.path.lexists(word)):
        return f"there is nothing at {word}; the command comes first{OVERVIEW}"
    return _about_folder(word) if _is_footage(word) else ""


def _about_folder(word: str) -> str:
    """Return the lines that import a folder: its pictures need one that says whose they are."""
    pictures = [path.suffix for path in Path(word).iterdir() if path.suffix.casefold() in IMAGE_SUFFIXES]
    return f"'{word}' is a folder: capture-app sessions import " + (
        f"{word.rstrip('/')}/*{pictures[0]} imports its pictures as one instant, "
        f"capture-app sessions import cam0={word} --fps RATE as one camera's"
        if pictures
        else f"{word} imports it"
    )


def _is_footage(word: str) -> bool:
    """Return whether a word is what people import: the name of a file of theirs, or a folder of theirs."""
    # os.path's raise for no word.
    return bool(
        (word.casefold().endswith(FOOTAGE) and not re.search(r"(\A|[/\\])out[^/\\]*\Z", word))
        or (
            word.strip("./")
            and not _shaped(word)
            and os.path.isdir(word)  # noqa: PTH112
            and not _session_at(word)
            # Nor is the folder of the sessions.
            and not any(Path(word).glob("*/session.json"))
        )
    )


def _session_at(word: str) -> str:
    """Return the path of the session that a word is, or names in ./sessions; empty for others."""
    word = word.strip("()[]\"',").replace("\\", "/")
    places = (Path(word), Path("sessions", word)) if word else ()
    return next(
        (place.as_posix() for place in places if os.path.isfile(place / "session.json")),  # noqa: PTH113 - the same
        "",
    )


def _in_our_words(error: click.UsageError, typed_line: Sequence[str]) -> str:
    """Return what an option or argument takes, and what it was given, instead of click's sentences."""
    text = error.message.rstrip(".")
    if isinstance(error, click.BadOptionUsage):
        return f"{error.option_name} needs a value" if "requires an argument" in text else text
    if not isinstance(error, click.BadParameter) or error.param is None or error.ctx is None:
        return text
    name, kind, path = (
        error.param.get_error_hint(error.ctx).replace("'", ""),
        error.param.type,
        error.ctx.command_path,
    )
    if isinstance(error, click.MissingParameter):
        add = (
            f"add {name} {error.param.make_metavar(error.ctx)}"
            if name[:1] == "-"
            else f"{path} takes {_takes(error.ctx)}"
        )
        words = list(takewhile(lambda word: word[:1] != "-", typed_line[len(path.split()) - 1 :]))
        footage = " ".join(words[:3]) if words and _is_footage(words[0]) else ""
        notes = [
            *(f"{word} is {line}" for word in words for line in _shaped(word)[:1]),
            *(f"{word} is --against {word}" for word in words[1:] if "--against" in _options(error.ctx)),
            *(["footage is imported first: capture-app sessions import " + footage] if footage else []),
        ]
        return "; ".join((f"{name} is missing", _LISTS.get(name, add), *notes))
    given, is_not, _ = text.partition(" is not ")
    if not is_not or kind.name not in _NUMBERS:
        return f"{name}: {text}"
    low, high, is_open = (getattr(kind, part, None) for part in ("min", "max", "min_open"))
    limits = "".join(
        f" {word} {bound:.9g}"
        for word, bound in (("above" if is_open else "from", low), ("to", high))
        if bound is not None
    )
    value = _in_unit(given, name)
    return f"{name} takes {_NUMBERS[kind.name]}{limits}, not {given}{value and f': write {value}'}"


def _in_unit(text: str, option: str) -> str:
    """Return a number such as `2min` in the unit of an option; empty if it has no unit of that kind."""
    numbers = re.findall(r"(\d+(?:\.\d+)?) ?([a-z]+)\b", text.casefold())
    return next(
        (
            f"{float(number) * kind[unit] / kind[own]:.9g}"
            for number, unit in numbers
            for kind in _UNITS
            for own in {option.rpartition("-")[2]} & {*kind}
            if unit in kind
        ),
        "",
    )


def _option_for(given: str, ctx: click.Context) -> str:
    """Return how to write an argument that a command does not take; empty if nothing fits."""
    kinds = {param.opts[0]: param.type.name for param in ctx.command.get_params(ctx)}
    # A number is a camera where there are cameras.
    takers = [option for option, kind in kinds.items() if option[:1] == "-" and kind in _NUMBERS]
    options = [f"{option} {value}" for option in takers if (value := _in_unit(given, option))]
    if "--against" in kinds or (given.isdecimal() and "--camera" not in kinds):
        options += [f"{option} {given}" for option in ("--against", *takers) if option in kinds]
    return f"write {options[0]}" if options else "put the text in quotes" if "text" in kinds else ""
