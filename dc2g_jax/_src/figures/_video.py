"""Writers of GIF files with one color table, and of MP4 files."""

import collections
import contextlib
import importlib.util
import itertools
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image

from dc2g_jax._src.files.class_images import color_codes
from dc2g_jax._src.runtime.errors import InputError

Picture = UInt8[np.ndarray, "height width 3"]

#: Colors in the table of a GIF; the last entry stays free for pixels that do not change from one picture to the next.
_MOST_COLORS = 255


def _rgb(codes: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n 3"]:
    return codes[:, None] >> np.array([16, 8, 0]) & 255


def frequent_colors(shown: Iterable[Picture], always: Sequence[str]) -> Int[np.ndarray, "n"]:
    """The most frequent colors of pictures, as sorted integers, at most as many as a GIF can have.

    The colors `always`, as `#rrggbb`, are included even if they are rare.
    """
    counts: collections.Counter[int] = collections.Counter()
    marks = [int(color[1:], 16) for color in always]
    for picture in shown:
        found, often = np.unique(color_codes(picture), return_counts=True)
        counts.update(dict(zip(found.tolist(), often.tolist(), strict=True)))
    frequent = [code for code, _ in counts.most_common() if code not in marks]
    return np.array(sorted(marks + frequent[: _MOST_COLORS - len(marks)]), np.int32)


def write_gif(path: Path, shown: Iterator[Picture], colors: Int[np.ndarray, "n"], durations: Sequence[float]) -> None:
    """Write a GIF that repeats. All pictures share one color table, and only changes are stored.

    Colors outside the table, which `frequent_colors` makes, are replaced by the nearest in it. Durations are in
    seconds.
    """
    table = _rgb(np.pad(colors, (0, _MOST_COLORS + 1 - len(colors)))).astype(np.uint8).tobytes()

    def indexed(picture: Picture) -> Image.Image:
        codes = color_codes(picture)
        index = np.minimum(np.searchsorted(colors, codes), len(colors) - 1)
        others = colors[index] != codes
        found, inverse = np.unique(codes[others], return_inverse=True)
        off = np.abs(_rgb(found)[:, None] - _rgb(colors)).sum(axis=-1)
        index[others] = np.argmin(off, axis=1)[inverse]
        image = Image.fromarray(index.astype(np.uint8))
        image.putpalette(table)
        image.info["transparency"] = _MOST_COLORS
        return image

    images = map(indexed, shown)
    milliseconds = [round(1000 * seconds) for seconds in durations]
    next(images).save(
        path, save_all=True, append_images=images, duration=milliseconds, loop=0, optimize=True, palette=table
    )


def h264_encoder() -> str | None:
    """The program that encodes H.264; `None` if there is none."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        return None
    from imageio_ffmpeg import get_ffmpeg_exe

    try:
        return get_ffmpeg_exe()
    except RuntimeError:  # installed without the program
        return None


def write_mp4(path: Path, shown: Iterator[Picture], frames_per_second: int, last_seconds: float, program: str) -> None:
    """Write an MP4 in H.264, which office programs and browsers open, of pictures of even width and height.

    Raises:
      InputError: the encoder `program`, see `h264_encoder`, cannot write to the path.
    """
    first = next(shown)
    height, width, _ = first.shape
    pictures = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(frames_per_second)]
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
    command = [program, "-v", "quiet", "-y", *pictures, "-i", "-", *coded, str(path.absolute())]
    # A pipe that breaks means that the encoder has failed, as its status says.
    with contextlib.suppress(BrokenPipeError), subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        last = first
        for last in itertools.chain([first], shown):
            encoder.stdin.write(last.tobytes())
        for _ in range(round(last_seconds * frames_per_second)):
            encoder.stdin.write(last.tobytes())
    if encoder.returncode != 0:
        raise InputError(f"{path}: cannot be written as MP4; give another file, or one that ends in .gif")
