# genesplat with all that it starts: pycolmap for poses, ffmpeg for videos, Vulkan for cards.
#
#   docker build -t genesplat .
#
# On the CPU, with your photos in the folder that you are in:
#   docker run --rm -v "$PWD:/work" --user "$(id -u):$(id -g)" genesplat train --poses photos --out run
# On a card of NVIDIA's (its Container Toolkit brings the driver, whose Vulkan needs the capability "graphics", set below):
#   docker run --rm --gpus all -v "$PWD:/work" --user "$(id -u):$(id -g)" genesplat train --poses photos --out run
# On a card of AMD's or Intel's (Mesa's driver is in the image):
#   docker run --rm --device /dev/dri --group-add "$(stat -c %g /dev/dri/renderD128)" \
#     -v "$PWD:/work" --user "$(id -u):$(id -g)" genesplat train --poses photos --out run
# `genesplat devices` in the same place says which card is found.
# To look at a run while it trains: `-p 127.0.0.1:7007:7007` for docker, `--view --view-address 0.0.0.0:7007` for genesplat.

FROM rust:1.95-slim-bookworm AS build
WORKDIR /src
COPY . .
RUN cargo build --release --locked -p genesplat

# pycolmap's wheels are for Python's image, not for Debian's own Python; x86-64 only.
FROM python:3.12-slim-bookworm
# libegl1 and libxext6: NVIDIA's Vulkan driver, which comes from the host, is linked with them.
RUN apt-get update \
    && apt-get install -y --no-install-recommends ffmpeg libegl1 libvulkan1 libxext6 mesa-vulkan-drivers \
    && rm -rf /var/lib/apt/lists/* \
    && pip install --no-cache-dir numpy==2.4.6 pillow-heif==1.8.1 pycolmap==4.2.1 \
    && useradd --uid 1000 --create-home genesplat
COPY --from=build /src/target/release/genesplat /usr/local/bin/genesplat
# Caches of drivers go where any user may write. Mesa's choice of a device wants a desktop: not needed.
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,graphics,utility \
    NODEVICE_SELECT=1 \
    XDG_CACHE_HOME=/tmp
USER 1000
WORKDIR /work
ENTRYPOINT ["genesplat"]
CMD ["--help"]
