# Nermo with ROS 2 Kilted and all that it needs, built: `docker build -t nermo .`, then `docker run --rm -it nermo demo`.
ARG ROS_DISTRO=kilted
FROM ros:${ROS_DISTRO}-ros-base

SHELL ["/bin/bash", "-euo", "pipefail", "-c"]
WORKDIR /nermo
COPY . .
# What the doctor says is missing, then the set-up that every command begins with.
RUN apt-get update -q \
    && PYTHONPATH=src/nermo_bringup:src/nermo_description python3 -m nermo_bringup.environment.doctor --missing-apt \
    | xargs -r apt-get install -qy --no-install-recommends \
    && rm -rf /var/lib/apt/lists/*
RUN source "/opt/ros/${ROS_DISTRO}/setup.bash" && ./nermo --help
ENTRYPOINT ["/bin/bash", "-c", "source /opt/ros/$ROS_DISTRO/setup.bash && exec ./nermo \"$@\"", "nermo"]
CMD ["--help"]
