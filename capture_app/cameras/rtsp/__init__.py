"""IP cameras by RTSP: the connection, its packets, the sender's clock, and the camera of them."""
