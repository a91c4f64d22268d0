"""Page: the HTML that shows a picture, live from the server or standalone with the picture inside.

The page is meshcat's script plus one of ours (``web/page.js``), which adds a better background, lights and camera,
objects that are drawn many times at once, a card with numbers and legend, and buttons for what plays.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import zlib
from functools import cache
from pathlib import Path

from elastic_strips.viewer.server import Record

_WEB = Path(__file__).parent / "web"


@cache
def _text(name: str) -> str:
    return "\n" + (_WEB / name).read_text(encoding="utf-8")


@cache
def _meshcat_script() -> str:
    """Read meshcat's bundle without importing meshcat, which would import half of Jupyter."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("meshcat is not installed; it comes with elastic-strips: pip install meshcat")
    return (Path(spec.submodule_search_locations[0]) / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def _page(title: str, last: str, data: str = "") -> str:
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{html.escape(title)}</title>
<style>{_text("page.css")}</style></head>
<body>
<div id="meshcat-pane"></div>
<div id="es-card"></div>
<div id="es-play"><button id="es-toggle" title="play or pause"></button>
<input id="es-time" type="range" min="0" max="1" step="0.01" value="0"><output id="es-now"></output></div>
{data}
<script>{_meshcat_script()}</script>
<script>{_text("page.js")}{_text(last)}</script>
</body>
</html>
"""


def live_page(title: str) -> str:
    """Return the page that asks its server for the picture."""
    return _page(title, "live.js")


def static_page(title: str, record: Record) -> str:
    """Return a standalone page with the picture inside; it needs no server and no network."""
    packed = base64.b64encode(zlib.compress(record.batch(), 9)).decode()
    return _page(title, "standalone.js", f'<script id="es-data" type="application/octet-stream">{packed}</script>')


def inline_frame(page: str, height: int = 480) -> str:
    """Wrap a standalone page for a notebook."""
    source = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe srcdoc="{source}" style="width: 100%; height: {height}px; border: 0; border-radius: 8px"></iframe>'
