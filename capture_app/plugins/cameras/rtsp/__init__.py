"""IP cameras over RTSP: connection, RTP packets, the sender's clock, and the camera itself."""
