"""What MkDocs asks while it builds the docs site (mkdocs.yml): pages that come from the code.

Every room of the package gets a page with all its public names, every file that a page links to outside of docs/ a page
that shows it, and the examples an index. Docstrings are plain text with a little reStructuredText in them; a Griffe
extension turns that into Markdown.
"""

from __future__ import annotations

import ast
import posixpath
import re
from pathlib import Path

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "elastic_strips"
EXAMPLES = ROOT / "scripts" / "examples"
NOTEBOOKS = ROOT / "notebooks"
LINK = re.compile(r"\]\((\.\./[^)#\s]+)(#[^)\s]*)?\)")
LANGUAGES = {".py": "python", ".sh": "bash", ".yaml": "yaml", ".cff": "yaml"}
FENCE = re.compile(r"^```(\w+) [^\n{]+$", re.MULTILINE)
"""First line of a block with a word for the tests, as in ```python sketch: Markdown knows no such blocks."""
ATTRIBUTES = re.compile(r"^Attributes:\n((?:[ ]{4}.*(?:\n|\Z))+)", re.MULTILINE)
"""The section of a docstring that lists attributes."""
SEVERAL = re.compile(r"^ {4}[\w*]+(?:, [\w*]+)+(?=:)", re.MULTILINE)
"""Names of a section that have one description together."""
ROLE = re.compile(r":(?:class|meth|func|mod|attr|data|exc):`~?([^`]+)`")


def rooms() -> dict[str, list[str]]:
    """Public names of each room, and of the package itself, by its dotted name; rooms without any are left out."""
    found = {}
    for path in sorted(PACKAGE.rglob("__init__.py"), key=lambda p: p.parent.as_posix()):
        name = ".".join(path.parent.relative_to(PACKAGE.parent).parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                found[name] = list(ast.literal_eval(node.value))
    return found


def first_line(path: Path) -> str:
    """First sentence of a file's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return ROLE.sub(r"`\1`", text.split("\n\n")[0].replace("\n", " "))


def entry(room: str, name: str) -> str:
    """Source of the entry of one public name.

    Griffe takes a module for what is meant where a name is both (``planning.plan``): then the name inside is asked for,
    and an anchor put where others look for it.
    """
    folder = PACKAGE.parent.joinpath(*room.split("."))
    if (folder / f"{name}.py").is_file():
        return f"[](){{#{room}.{name}}}\n\n::: {room}.{name}.{name}"
    return f"::: {room}.{name}"


def api_pages() -> dict[str, str]:
    """Source of the API's pages by their paths."""
    rows, pages = [], {}
    for room, names in rooms().items():
        short = room.partition(".")[2] or "elastic_strips"
        about = first_line(PACKAGE.parent.joinpath(*room.split(".")) / "__init__.py")
        listed = ", ".join(f"[`{name}`](#{room}.{name})" for name in names if name != "__version__")
        if room == "elastic_strips":  # its names have their places in the rooms
            homes = {name: home for home, its in rooms().items() if home != room for name in its}
            links = [
                f"[`{name}`]({homes[name].partition('.')[2]}.md#{homes[name]}.{name})"
                for name in names
                if name in homes
            ]
            errors = [f"[`{name}`](errors.md#elastic_strips.errors.{name})" for name in names if name.endswith("Error")]
            rows.append(f"| `es` (`elastic_strips`) | {about} | {', '.join([*links, *errors])} |")
            continue
        pages[f"api/{short}.md"] = "\n\n".join(
            [f"# {short}", f"`{room}`: {about}", listed, *(entry(room, name) for name in names)]
        )
        rows.append(f"| [{short}]({short}.md) | {about} | {len(names)} |")
    pages["api/errors.md"] = (
        "# errors\n\n`elastic_strips.errors`: what is raised on purpose.\n\n"
        "::: elastic_strips.errors\n    options:\n      heading_level: 1\n      show_bases: true\n"
    )
    rows.append("| [errors](errors.md) | the one tree of errors | |")
    table = "\n".join(["| room | what it is for | names |", "|---|---|---|", *rows])
    pages["api/index.md"] = (
        "# API\n\nEach room has a page with its public names. What most programs need stands at the top, too, as "
        f"`es.…`. [Architecture](../architecture.md) says how the rooms work together.\n\n{table}\n"
    )
    return pages


def shown(path: Path) -> str:
    """Source of a page that shows a file."""
    language, text = LANGUAGES.get(path.suffix, "text"), path.read_text(encoding="utf-8")
    name = path.relative_to(ROOT).as_posix()
    return f"# {path.name}\n\n`{name}`\n\n``````{language}\n{text}``````\n"


def page_of(path: Path) -> str | None:
    """Where in the site a file outside of docs/ is shown; None where it is not."""
    if path == EXAMPLES:
        return "examples/index.md"
    if path == ROOT / "README.md":
        return "index.md"
    if path.parent == EXAMPLES:
        return f"examples/{path.stem}.md"
    if path == NOTEBOOKS:
        return "notebooks/index.md"
    if path.parent == NOTEBOOKS:
        return f"notebooks/{path.stem}.md"
    return f"source/{path.relative_to(ROOT).as_posix()}.md" if path.is_file() else None


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages that come from the code into the navigation, under the indexes that stand there; and those of docs/
    that mkdocs.yml does not place under *More*, so that none is forgotten."""
    inside = {
        "api/index.md": [{page[4:-3]: page} for page in api_pages() if page != "api/index.md"],
        "examples/index.md": [f"examples/{path.stem}.md" for path in sorted(EXAMPLES.glob("*.py"))],
        "notebooks/index.md": [f"notebooks/{path.stem}.md" for path in sorted(NOTEBOOKS.glob("*.ipynb"))],
    }
    named = set[str]()
    for section in config.nav or []:
        for entries in section.values():
            for k, item in enumerate(entries):
                ((title, page),) = item.items() if isinstance(item, dict) else [("", item)]
                named.add(page)
                if page in inside and title:
                    entries[k] = {title: [page, *inside[page]]}
                elif page in inside:
                    entries.extend(inside[page])
                    break
    left = sorted({path.name for path in Path(config.docs_dir).glob("*.md")} - named)
    if left and config.nav:
        config.nav.append({"More": left})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that come from the code."""
    pages = api_pages()
    examples = sorted(EXAMPLES.glob("*.py"))
    pages |= {f"examples/{path.stem}.md": shown(path) for path in examples}
    rows = [f"| [{path.stem}]({path.stem}.md) | {first_line(path)} |" for path in examples]
    about = "They are in `scripts/examples`; each is one idea, and a test runs it."
    pages["examples/index.md"] = "\n".join(["# Examples", "", about, "", "| | |", "|---|---|", *rows])
    for file in files.documentation_pages():
        for target, _ in LINK.findall(file.content_string):
            path = (Path(config.docs_dir) / file.src_uri).parent.joinpath(target).resolve()
            page = page_of(path) or ""
            if page.startswith("source/") and not path.is_relative_to(config.docs_dir):
                pages[page] = shown(path)
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links out of docs/ lead to the pages that show what is there."""
    here = Path(config.docs_dir) / page.file.src_uri

    def lead(match: re.Match[str]) -> str:
        path = here.parent.joinpath(match[1]).resolve()
        if path.is_relative_to(config.docs_dir):
            return match[0]
        target = page_of(path)
        if target is None or files.get_file_from_path(target) is None:
            raise ValueError(f"{page.file.src_uri}: {match[1]} has no page in the site")
        return f"]({posixpath.relpath(target, posixpath.dirname(page.file.src_uri) or '.')}{match[2] or ''})"

    return FENCE.sub(r"```\1", LINK.sub(lead, markdown))


class PlainDocstrings(griffe.Extension):
    """Turns what the docstrings have of reStructuredText into Markdown, and tells of inherited attributes."""

    def on_object(self, *, obj: griffe.Object, **kwargs: object) -> None:
        """Rewrite one docstring."""
        if obj.docstring:
            text = ROLE.sub(r"`\1`", obj.docstring.value).replace("``", "`")
            text = SEVERAL.sub(lambda match: match[0].replace(", ", ",\u202f"), text)  # else the second is a type
            obj.docstring.value = re.sub(r"(?m)::$", ":", text)

    def on_package(self, *, pkg: griffe.Module, **kwargs: object) -> None:
        """Say of each public class what it has of bases that have no entry of their own."""
        names = {f"{room}.{name}" for room, its in rooms().items() for name in its}
        public = {pkg[name.partition(".")[2]].canonical_path for name in names if name.count(".") > 1}
        for path in sorted(public):
            found = pkg[path.partition(".")[2]]
            if found.is_class and found.docstring:
                bases = [base for base in found.mro() if base.canonical_path not in public and base.docstring]
                inherited = [ATTRIBUTES.search(base.docstring.value) for base in bases]
                lines = "".join(match[1] for match in inherited if match)
                own = ATTRIBUTES.search(found.docstring.value)
                if lines and own:
                    text, end = found.docstring.value, own.end(1)
                    found.docstring.value = f"{text[:end].rstrip()}\n{lines}{text[end:]}"
                elif lines:
                    found.docstring.value += f"\n\nAttributes:\n{lines}"
