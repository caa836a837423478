# The command dc2g: docker build --tag dc2g . && docker run --rm -v "$PWD:/work" dc2g compare --family procedural
# For an NVIDIA GPU: --build-arg EXTRAS=all,cuda when it is built, and --gpus all when it is run.
FROM python:3.13-slim

ARG EXTRAS=all
COPY pyproject.toml README.md LICENSE /source/
COPY dc2g_jax /source/dc2g_jax
RUN pip install --no-cache-dir "/source[${EXTRAS}]" && rm -r /source

# Downloads and compiled programs: mount a volume here to keep them.
ENV DC2G_CACHE=/cache
WORKDIR /work
ENTRYPOINT ["dc2g"]
CMD ["--help"]
