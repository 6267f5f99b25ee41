"""Timeouts after which a silent peer, device or process counts as lost or failed.

Camera drivers have their own.
"""

# Datagrams between engines
LEADER_SILENT_NS = 1_500_000_000
"""A client counts its leader as lost: three heartbeats, and all other requests, are unanswered."""
CLIENT_SILENT_NS = 2_000_000_000
"""A leader counts a client as lost."""
CLIENT_UNREPORTED_NS, UNREPORTED_PER_CLIENT_NS = 6_000_000_000, 125_000_000
"""A relay does not report a client; the second is added for each client of the rig, as relays report few at
once."""
FORGET_LOST_NS = 600_000_000_000
"""A lost member leaves the roster."""
TRIGGER_GIVE_UP_NS = 5_000_000_000
"""A trigger that a client has not acknowledged is no longer repeated."""

# Streams
PROBE_TIMEOUT_S = 1.5
"""An address that is probed does not answer; WiFi may have to wake up."""
CLOSE_TIMEOUT_S = 30.0
"""A peer does not take in the end of a stream that is closed."""
ANSWER_TIMEOUT_S = 10.0
"""A leader does not answer a request."""
ORDER_TIMEOUT_S = 40.0
"""A leader does not confirm an order; a camera that it starts has to be opened first."""
STATUS_TIMEOUT_S = 10.0
"""An operator hears no status; a leader sends one at least every 3 s."""
NODE_ANSWER_TIMEOUT_S = 5.0
"""A node does not answer a request that its leader passes on."""
UPLOAD_ANSWER_TIMEOUT_S = 30.0
"""A leader does not acknowledge a report or an image."""
UPSTREAM_TIMEOUT_S = 2.0
"""A relay's parent does not answer a stream that the relay forwards."""
JOIN_TIMEOUT_S = 10.0
"""A leader does not let a measuring client join."""

# Bursts
CAMERA_DISCONNECTED_NS = 10_000_000_000
"""A camera has no stream open: the burst goes on without it."""
ALL_DISCONNECTED_NS = 3_600_000_000_000
"""All cameras of a recording or a long burst are silent, as their network is down: it ends."""
CAMERA_DISCONNECTED_AGAIN_NS = 2_000_000_000
"""The same for a camera that was silent in the burst before."""
CAMERA_STALLED_NS = 180_000_000_000
"""A camera has a stream open and sends nothing of any burst."""
MIN_UPLOAD_BYTES_PER_S = 16 << 10
"""Images that arrive more slowly use up the time before: at 2 KB/s a camera has stalled after 206 s."""
AFTER_LAST_INSTANT_NS = 2_000_000_000
"""These times count from this long after a camera's last frame: a burst in which nothing moves ends 182 s
after its last instant."""
RETURN_NS = 60_000_000_000
"""Nodes do not come back with the images of an interrupted burst."""
DISK_RETRY_S = 10.0
"""The leader's disk refused a session: it is tried again, if there is room."""
BUSY_TIMEOUT_S = 5.0
"""A burst is still under way, after which cameras may be staggered; they select frames for a second."""
UNDECIDED_S = 0.1
"""The instants requested from a camera depend on other cameras, which have not reported yet."""

# Processes
RIG_START_TIMEOUT_S = 60.0
"""A rig in the background does not answer after its start."""
RIG_STOP_TIMEOUT_S = 60.0
"""A rig does not end; it saves the bursts that are under way first."""
NODE_START_TIMEOUT_S = 15.0
"""A camera's process has not opened its camera."""
PHONES_START_TIMEOUT_S = 30.0
"""The server of phones shows no invitation."""
DEPARTURE_TIMEOUT_S = 3.0
"""A node that was ended has not left the roster."""
NODE_STOP_TIMEOUT_S = 30.0
"""A camera's process that was asked to end still saves its frames: it is killed."""
CHILD_STOP_TIMEOUT_S = 2.0
"""A child process that was asked to end is killed."""
SCREEN_STOP_TIMEOUT_S = 10.0
"""The screen closes though its rig has not ended."""

# Plugins of other packages
PLUGIN_TIMEOUT_S = 15.0
"""A plugin is still being imported: it is skipped. At a load of 27, importing numpy took over 5 s."""
NAMED_PLUGIN_TIMEOUT_S = 60.0
"""The same for a plugin that was asked for by name."""

# Cameras to become ready
READY_TIMEOUT_S = 120.0
"""Cameras are not ready."""
DEGRADED_WAIT_S = 5.0
"""A clock that has just become less accurate than requested has not recovered."""
NO_FRAME_TIMEOUT_S = 15.0
"""A camera that is characterized gives no frames."""

# Phones
PAGE_CLOSED_S = 60.0
"""A phone whose page is closed leaves the rig."""
PHONE_IMAGE_TIMEOUT_S = 15.0
"""A phone does not send an image, over a link that may come back."""
IDENTIFY_TIMEOUT_S = 20.0
"""A connection has not identified itself."""
HANDSHAKE_TIMEOUT_S = 10.0
"""A connection has not completed its TLS handshake."""
