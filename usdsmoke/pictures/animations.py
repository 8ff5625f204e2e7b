"""Animations out: WebP and GIF, which Pillow writes, and MP4, for which PyAV is needed."""

import os
from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, features

from usdsmoke.base.errors import ImageError, WriteFailed
from usdsmoke.base.publish import publish_file

_QUALITY = 90  # WebP, of 100; a lossless picture of the example plume is five times as large
# crf: 0 is lossless, and differences are hard to see below 18; bf: with pictures out of order the
# duration of the last one is lost
_H264 = {"crf": "16", "bf": "0"}
_GIF_TICK = 10  # milliseconds: GIF counts time in these
_BT709, _TV_RANGE = 1, 1  # numbers of H.264's tables

FilePath = str | os.PathLike[str]


def write_webp(
    file_path: FilePath, pictures: Sequence[np.ndarray], milliseconds: Sequence[int]
) -> None:
    """Write pictures as one animated WebP that repeats for ever, in one step.

    Args:
        file_path: path of the file; its folder must exist. An old file is replaced.
        pictures: [H W 3] of one size, display-encoded in [0, 1]; at least one.
        milliseconds: how long each stays.

    Raises:
        ImageError: this Pillow writes no WebP.
        WriteFailed: the operating system refused, or the file came back different.
    """
    if not features.check("webp"):
        raise ImageError(
            f"cannot write {os.fspath(file_path)}: this Pillow has no WebP. Write .png instead."
        )
    images = [Image.fromarray(_levels(picture)) for picture in pictures]
    settings = {"quality": _QUALITY, "duration": list(milliseconds)}
    _publish_images(file_path, "WEBP", images, settings)


def write_gif(
    file_path: FilePath, pictures: Sequence[np.ndarray], milliseconds: Sequence[int]
) -> None:
    """Write pictures as one animated GIF that repeats for ever, in one step.

    Every picture has its own 256 colours, dithered. Times are rounded to hundredths of a second,
    without drift.

    Args:
        file_path, pictures, milliseconds: see ``write_webp``.

    Raises:
        WriteFailed: the operating system refused, or the file came back different.
    """
    images = []
    for picture in pictures:
        image = Image.fromarray(_levels(picture))
        # the octree leaves colours that smoke has little of; with Pillow's default, grey specks
        palette = image.quantize(method=Image.Quantize.FASTOCTREE)
        images.append(image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG))
    ends = [round(end / _GIF_TICK) * _GIF_TICK for end in np.cumsum([0, *milliseconds])]
    durations = [max(_GIF_TICK, after - before) for before, after in pairwise(ends)]
    _publish_images(file_path, "GIF", images, {"duration": durations})


def write_mp4(
    file_path: FilePath, pictures: Sequence[np.ndarray], milliseconds: Sequence[int]
) -> None:
    """Write pictures as one MP4 (H.264, BT.709, 4:2:0), in one step.

    A side with an odd number of pixels gets one more, which repeats its neighbour.

    Args:
        file_path, pictures, milliseconds: see ``write_webp``.

    Raises:
        ModuleNotFoundError: PyAV is not installed.
        ImageError: this PyAV cannot write H.264.
        WriteFailed: the operating system refused, or the file came back different.
    """
    import av

    height, width = (side + side % 2 for side in pictures[0].shape[:2])
    ends = np.cumsum([0, *milliseconds])
    durations = dict(zip(ends.tolist(), milliseconds, strict=False))

    def timed(packets: "list[av.Packet]") -> "list[av.Packet]":
        for packet in packets:  # else the last picture's would be unknown
            packet.duration = durations[packet.pts]
        return packets

    def write(temporary: Path) -> None:
        with av.open(os.fspath(temporary), "w", options={"movflags": "faststart"}) as film:
            rate = Fraction(1000 * len(pictures), int(ends[-1])).limit_denominator(1001)
            try:
                stream = film.add_stream("h264", rate=rate, options=_H264)
            except (av.error.FFmpegError, ValueError):
                raise ImageError(
                    f"cannot write {os.fspath(file_path)}: this PyAV has no H.264 encoder. "
                    "Write .webp instead."
                ) from None
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            coder = stream.codec_context
            coder.thread_count = 1  # with more, bytes depend on their number
            coder.time_base = Fraction(1, 1000)
            coder.colorspace = coder.color_primaries = coder.color_trc = _BT709
            coder.color_range = _TV_RANGE
            for number, picture in enumerate(pictures):
                frame = av.VideoFrame.from_ndarray(_even(_levels(picture)), format="rgb24")
                frame = frame.reformat(
                    format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
                )
                frame.time_base, frame.pts = Fraction(1, 1000), int(ends[number])
                film.mux(timed(stream.encode(frame)))
            film.mux(timed(stream.encode(None)))

    def check(temporary: Path) -> None:
        with av.open(os.fspath(temporary)) as film:
            found = [(frame.height, frame.width) for frame in film.decode(video=0)]
        if found != [(height, width)] * len(pictures):
            raise _different(file_path)

    publish_file(Path(file_path), write, check)


WRITERS: dict[str, Callable[[FilePath, Sequence[np.ndarray], Sequence[int]], None]] = {
    ".webp": write_webp, ".gif": write_gif, ".mp4": write_mp4,
}  # fmt: skip


def _publish_images(
    file_path: FilePath, kind: str, images: Sequence[Image.Image], settings: dict[str, object]
) -> None:
    def write(temporary: Path) -> None:
        images[0].save(temporary, kind, save_all=True, append_images=images[1:], loop=0, **settings)

    def check(temporary: Path) -> None:
        """Pictures that do not change are stored as one, so that only their size is certain."""
        with Image.open(temporary) as found:
            if found.size != images[0].size:
                raise _different(file_path)
            found.seek(getattr(found, "n_frames", 1) - 1)
            found.load()

    publish_file(Path(file_path), write, check)


def _levels(picture: np.ndarray) -> np.ndarray:
    levels: np.ndarray = np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)
    return levels


def _even(levels: np.ndarray) -> np.ndarray:
    sides = [(0, side % 2) for side in levels.shape[:2]]
    return np.ascontiguousarray(np.pad(levels, [*sides, (0, 0)], mode="edge"))


def _different(file_path: FilePath) -> WriteFailed:
    return WriteFailed(
        f"{os.fspath(file_path)} read back differently from what was written. Check whether the "
        "disk is full, and write it again."
    )
