"""A program that takes streams at the ports it is given, and answers no datagram."""

import socket
import sys
import threading

if __name__ == "__main__":
    listening = [socket.create_server(("", int(port))) for port in sys.argv[1:]]
    bound = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in listening]
    for sock, stream in zip(bound, listening, strict=True):
        sock.bind(stream.getsockname())
    print("listening", flush=True)
    threading.Event().wait()
