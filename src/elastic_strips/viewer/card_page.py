"""A page with a robot's card: its picture, which can be turned, above its tables."""

from __future__ import annotations

import html

from elastic_strips.robot.card import RobotCard

from .commands import inline_frame

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1f2933; margin: 0 auto; max-width: 1180px; padding: 16px; }
h1 { margin: 0.2em 0 0; } iframe { margin: 12px 0; background: #eef1f4; }
.troubles { background: #fff4d6; border-left: 5px solid #f0b400; padding: 10px 10px 10px 32px; border-radius: 4px; }
details { margin: 10px 0; } summary { font-weight: 600; cursor: pointer; }
table { border-collapse: collapse; margin: 6px 0 14px; } th { text-align: left; color: #52606d; font-weight: 600; }
th, td { padding: 3px 14px 3px 0; border-bottom: 1px solid #e4e7eb; vertical-align: top; overflow-wrap: anywhere; }
p { margin: 4px 0; color: #52606d; }
"""


def card_page(card: RobotCard, picture: str) -> str:
    """A standalone page of a card.

    Args:
        card: the card.
        picture: a page of the viewer's, as ``Viewer.html`` gives it.
    """
    top, _, tables = card.html().partition("<details")
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(card.name)}</title>'
        f'<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        f"<style>{_STYLE}</style></head>\n<body>\n{top}\n{inline_frame(picture)}\n<details{tables}\n</body></html>\n"
    )
