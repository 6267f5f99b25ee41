# The machine that leads or reconstructs:
#   docker build -t simulshot .
#   docker run --network host -v simulshot:/home/simulshot simulshot capture-app leader
#   docker run -v simulshot:/home/simulshot simulshot reconstruct compare sessions/burst-001 --out compare
# The volume keeps sessions, and who was paired. A folder of the host in its place has to be uid 1000's.
FROM python:3.13-slim-trixie AS build
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc libc6-dev \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml hatch_build.py constraints.txt README.md LICENSE NOTICE ./
COPY capture_app capture_app
COPY reconstruction reconstruction
RUN python -m venv /opt/simulshot \
    && /opt/simulshot/bin/python -m pip install --no-cache-dir -c constraints.txt ".[reconstruction,people]" \
    && /opt/simulshot/bin/python -m reconstruction.methods.people.blazepose_weights

FROM python:3.13-slim-trixie
# What Open3D loads from the system, as in the Makefile.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/simulshot /opt/simulshot
ENV PATH=/opt/simulshot/bin:$PATH
RUN useradd --create-home --uid 1000 simulshot
USER simulshot
WORKDIR /home/simulshot
# 47010: UDP and TCP of the leader.
EXPOSE 47010/udp 47010/tcp
CMD ["capture-app", "leader"]
