"""Film: pictures and films of the viewer's pages, drawn by a Chromium without a window."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import InputError, missing_extra
from elastic_strips.files import atomic_write, check_writable, scratch_folder
from elastic_strips.progress import LoggedProgress
from elastic_strips.validation import check_number

from .browser import Browser

ENDINGS = (".gif", ".mp4", ".webm")
_BARE = "for (const e of document.querySelectorAll('.dg, #es-play, #es-bar')) e.style.visibility = 'hidden'; void 0"
_AT = "animator.pause(); animator.seek({0}); animator.display_progress({0}); viewer.render(); void 0"
_CODECS = {".mp4": "libx264", ".webm": "libvpx-vp9"}  # a WebM holds no H.264
_MOST_PICTURES = 5000  # pictures of a film


def save_picture(html: str, path: str | os.PathLike[str], *, size: tuple[int, int], time: float | None) -> Path:
    """Draw a standalone page.

    Args:
        html: the page.
        path: PNG to write.
        size: width and height [pixels].
        time: moment of playing [s]; the first where None, the last where infinite.

    Raises:
        BrowserError: there is no Chromium.
        InputError: another ending, or the file cannot be written.
    """
    path = check_writable(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: a picture ends in .png")
    with _opened(html, path, size) as browser:
        browser.evaluate(_AT.format("animator.duration" if time == np.inf else float(time or 0.0)))
        return atomic_write(path, browser.picture())


def save_film(html: str, path: str | os.PathLike[str], *, size: tuple[int, int], fps: float) -> Path:
    """Draw what plays in a standalone page, from beginning to end.

    Args:
        html: the page.
        path: .gif, .mp4 or .webm to write.
        size: width and height [pixels].
        fps: pictures a second.

    Raises:
        BrowserError: there is no Chromium.
        MissingExtraError: the extra ``film`` is not installed.
        InputError: nothing plays, another ending, or the file cannot be written.
    """
    target, _ = check_film(path, fps)
    with _opened(html, target, size) as browser:
        duration = browser.evaluate("animator.duration")
        seconds = float(duration) if isinstance(duration, (int, float)) else 0.0
        if not seconds > 0.0:
            raise InputError("nothing plays in this picture, so there is no film of it")
        with film_writer(path, fps=fps) as film:
            count = min(int(seconds * fps) + 1, _MOST_PICTURES)
            progress = LoggedProgress(f"drawing {target.name}", "pictures", count)
            for k in range(count):
                browser.evaluate(_AT.format(min(k / fps, seconds - 1e-3)))  # at its end it begins again
                film.add(browser.picture())
                progress.step()
    return film.path


class Film(Protocol):
    """A writer of the pictures of a film."""

    path: Path

    def add(self, picture: bytes) -> None:
        """Add a PNG."""


@contextmanager
def film_writer(path: str | os.PathLike[str], *, fps: float) -> Iterator[Film]:
    """Write a film picture by picture; the file is written whole or not at all.

    Raises:
        MissingExtraError: the extra ``film`` is not installed.
        InputError: another ending than .gif, .mp4 or .webm, or the file cannot be written.
    """
    path, ending = check_film(path, fps)
    import imageio.v2 as imageio

    with scratch_folder(path) as folder:
        there = folder / ("film" + ending)
        # A GIF's times are whole hundredths of a second.
        gif = ending == ".gif"
        writer = (
            imageio.get_writer(there, duration=10 * round(100 / fps), loop=0)
            if gif
            else imageio.get_writer(there, fps=fps, quality=8, macro_block_size=2, codec=_CODECS[ending])
        )
        with writer:
            film = _Frames(path, lambda frame: writer.append_data(frame))  # its own type says less than it takes
            yield film
        if not gif and _pictures(there) < film.count:  # ffmpeg ends without a word where the disk is full
            raise InputError(f"{path}: cannot write: ffmpeg's film lacks pictures; is the disk full?")
        data = there.read_bytes()
    atomic_write(path, data)


def _pictures(film: Path) -> int:
    """How many pictures a film has; none where it cannot be read."""
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.count_frames_and_secs(str(film))[0] or 0
    except (OSError, RuntimeError):
        return 0


def check_film(path: str | os.PathLike[str], fps: float = 20.0) -> tuple[Path, str]:
    """The file and its ending, where it can be written; to be called before there is something to film.

    Raises:
        MissingExtraError: the extra ``film`` is not installed.
        InputError: another ending, or the file cannot be written.
    """
    path = check_writable(path)
    check_number("fps", fps, low=1.0, high=60.0)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{path}: a film ends in {', '.join(ENDINGS)}")
    try:
        import imageio  # noqa: F401

        if ending != ".gif":
            import imageio_ffmpeg  # noqa: F401 (imageio's own message names no extra)
    except ImportError:
        raise missing_extra("a film", "imageio" if ending == ".gif" else "imageio-ffmpeg", "film") from None
    return path, ending


class _Frames:
    def __init__(self, path: Path, append: Callable[[NDArray[np.uint8]], object]) -> None:
        self.path = path
        self.count = 0
        self._append = append

    def add(self, picture: bytes) -> None:
        from PIL import Image

        self.count += 1
        self._append(np.asarray(Image.open(BytesIO(picture)).convert("RGB")))


@contextmanager
def _opened(html: str, target: Path, size: tuple[int, int]) -> Iterator[Browser]:
    """A page in a browser, for a picture that becomes a file."""
    with scratch_folder(target) as folder, Browser(size=size) as browser:
        page = folder / "page.html"
        page.write_text(html, encoding="utf-8")
        browser.open(page)
        browser.evaluate(_BARE)
        yield browser
