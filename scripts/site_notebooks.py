"""What MkDocs asks for the notebooks' pages (mkdocs.yml), and what the tests ask: each is executed once.

Notebooks are kept without outputs. What they show is kept in ``out/notebooks`` until the notebook, the package or what
is installed changes; whoever asks first executes. Their code, texts and pictures become a page of the site; a picture
that can be turned becomes a file beside it, which the page shows once it is scrolled to.
"""

from __future__ import annotations

import base64
import fcntl
import hashlib
import html
import logging
import os
import re
import sys
import tempfile
from contextlib import nullcontext
from fnmatch import fnmatch
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

# By way of jsonschema nbformat reads grammars of addresses, for seconds; notebooks have none to be checked.
sys.modules.setdefault("rfc3987_syntax", None)  # pyright: ignore[reportArgumentType]

import nbformat  # noqa: E402
from mkdocs.config.defaults import MkDocsConfig  # noqa: E402
from mkdocs.exceptions import PluginError  # noqa: E402
from mkdocs.structure.files import File, Files  # noqa: E402

if TYPE_CHECKING:
    from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
KEPT = ROOT / "out" / "notebooks"
SECONDS = 240  # of a cell, at most
FRAME = re.compile(r'<iframe srcdoc="([^"]*)"')
LIVE = re.compile(r'<iframe src="http://127\.0\.0\.1')
TITLE = re.compile(r"<title>(.*?)</title>", re.DOTALL)
HEADING = re.compile(r"^#+ (.*)", re.MULTILINE)
WIDGET = "application/vnd.jupyter.widget-view+json"
ABSENT = '<p class="absent">{} is live: run the notebook to have it.</p>'
_log = logging.getLogger("mkdocs.hooks.notebooks")


class NotebookPage(NamedTuple):
    """A notebook as Markdown, and the files that it shows, by their names beside it."""

    text: str
    files: dict[str, bytes]


@cache
def _code() -> bytes:
    """Digest of all that makes a notebook's outputs, but for the notebook."""
    digest = hashlib.sha256()
    for folder in (ROOT / "src", ROOT / "urdf"):
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    digest.update("\n".join(sorted(f"{each.name} {each.version}" for each in distributions())).encode())
    return digest.digest()


def _kept(path: Path) -> nbformat.NotebookNode | None:
    """The copy that was executed, where nothing has changed since."""
    copy = KEPT / path.name
    if not copy.is_file():
        return None
    notebook = nbformat.read(copy, as_version=4)
    return notebook if notebook.metadata.get("digest") == _digest(path) else None


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes() + _code()).hexdigest()


class Kernel:
    """A Python that executes one notebook after the other, each with names of its own; a context manager.

    What takes seconds of each is that a Python starts and imports: here that is done once.
    """

    def __init__(self) -> None:
        """None is started before it is needed."""
        self._client: NotebookClient | None = None

    def execute(self, notebook: nbformat.NotebookNode, folder: str) -> None:
        """Execute a notebook in a folder; its outputs are put into it.

        Raises:
            nbclient.exceptions.CellExecutionError: a cell raises.
        """
        from nbclient import NotebookClient

        if self._client is None:
            self._client = NotebookClient(
                notebook, timeout=SECONDS, kernel_name="python3", extra_arguments=["--log-level=ERROR"]
            )
        begin = nbformat.v4.new_code_cell(f"import os\nos.chdir({folder!r})\n%reset -f")
        self._client.nb = nbformat.v4.new_notebook(cells=[begin, *notebook.cells])
        found = os.pathsep.join(p for p in (str(ROOT / "src"), os.environ.get("PYTHONPATH", "")) if p)
        self._client.execute(cleanup_kc=False, env={**os.environ, "PYTHONPATH": found})

    def __enter__(self) -> Kernel:
        return self

    def __exit__(self, *_: object) -> None:
        from jupyter_core.utils import run_sync

        if self._client is not None and self._client.km is not None:
            run_sync(self._client.km.shutdown_kernel)(now=True)
            if self._client.kc is not None:
                self._client.kc.stop_channels()


def executed(path: Path, kernel: Kernel | None = None) -> nbformat.NotebookNode:
    """A notebook with its outputs: those that are kept, or else it is executed, by one process at a time.

    Args:
        path: the notebook.
        kernel: the one that executes it; none: one of its own.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell raises.
    """
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / f"{path.stem}.lock").open("w") as lock, tempfile.TemporaryDirectory() as folder:
        fcntl.flock(lock, fcntl.LOCK_EX)
        notebook = _kept(path)
        if notebook is None:
            notebook = nbformat.read(path, as_version=4)
            with nullcontext(kernel) if kernel else Kernel() as one:
                one.execute(notebook, folder)
            notebook.metadata["digest"] = _digest(path)
            part = Path(folder) / path.name
            nbformat.write(notebook, part)
            (KEPT / path.name).write_bytes(part.read_bytes())
    return notebook


def page(notebook: nbformat.NotebookNode, name: str) -> NotebookPage:
    """A notebook as a page ``name``.html.

    Raises:
        ValueError: it has an output that a page cannot show.
    """
    parts, files, heading = list[str](), dict[str, bytes](), name

    def beside(data: bytes, suffix: str) -> str:
        file = f"{name}-{len(files) + 1}{suffix}"
        files[file] = data
        return file

    def shown(output: nbformat.NotebookNode) -> str:
        if output.output_type == "stream":
            return _fenced(output.text, "{ .text .no-copy .output }")
        data = output.get("data", {})
        if WIDGET in data:
            return ABSENT.format("What is to be set here")
        if "text/html" in data:
            text = data["text/html"]
            if LIVE.match(text):
                return ABSENT.format("The picture that stands here")
            if (frame := FRAME.match(text)) is None:
                return f'<div class="output">{text}</div>'
            picture = html.unescape(frame[1])
            title = TITLE.search(picture)
            file = beside(picture.encode(), ".html")
            about = title[1] if title else heading
            return f'<iframe class="picture" src="{file}" title="{about}" loading="lazy"></iframe>'
        if "image/png" in data:
            file = beside(base64.b64decode(data["image/png"]), ".png")
            return f"[![{heading}]({file})]({file})"
        if "text/plain" in data:
            return _fenced(data["text/plain"], "{ .text .no-copy .output }")
        raise ValueError(f"{name}: no page shows an output {output.output_type!r} with {sorted(data)}")

    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            heading = (HEADING.findall(cell.source) or [heading])[-1]
            parts.append(cell.source)
            continue
        parts.append(_fenced(cell.source, "python"))
        parts += [shown(output) for output in _joined(cell.get("outputs", []))]
    return NotebookPage("\n\n".join(parts) + "\n", files)


def _joined(outputs: list[nbformat.NotebookNode]) -> list[nbformat.NotebookNode]:
    """Outputs, with what was printed in a row put together."""
    joined = list[nbformat.NotebookNode]()
    for output in outputs:
        if joined and output.output_type == joined[-1].output_type == "stream":
            joined[-1] = nbformat.v4.new_output("stream", text=joined[-1].text + output.text)
        else:
            joined.append(output)
    return joined


def _fenced(text: str, about: str) -> str:
    return f"``````{' ' if about.startswith('{') else ''}{about}\n{text.rstrip()}\n``````"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each notebook; those that ``extra: notebooks`` names are executed where no outputs are kept."""
    rows = list[str]()
    for path in NOTEBOOKS:
        name, notebook = path.stem, _kept(path)
        if notebook is None and fnmatch(name, config.extra["notebooks"] or ""):
            _log.info("Executing %s", path.name)
            try:
                notebook = executed(path)
            except ImportError as error:
                raise PluginError(f"{path.name} cannot be executed: {error}. pip install '.[docs,notebooks]'") from None
        about = f"[`{path.name}`]({path.name}), executed when this page was built."
        if notebook is None:
            notebook, about = nbformat.read(path, as_version=4), f"[`{path.name}`]({path.name}), not executed here."
        text, shown = page(notebook, name)
        title, _, rest = text.partition("\n")
        shown[path.name] = path.read_bytes()
        for file, data in shown.items():
            files.append(File.generated(config, f"notebooks/{file}", content=data))
        files.append(File.generated(config, f"notebooks/{name}.md", content=f"{title}\n\n{about}\n{rest}"))
        rows.append(f"- [{title.removeprefix('# ')}]({name}.md)")
    about = (
        "One idea each, done in seconds. The pictures can be turned, and played where something moves. To run them: "
        "`pip install '.[notebooks]'` in a checkout, then `jupyter lab notebooks`; or open them in VS Code "
        "([what is known of both](../viewer.md#in-a-notebook))."
    )
    index = "\n".join(["# Notebooks", "", about, "", *rows, ""])
    files.append(File.generated(config, "notebooks/index.md", content=index))
    return files
