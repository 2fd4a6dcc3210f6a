"""Hooks of the documentation site: one of mkdocs for its files, and one of griffe for the API reference."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from griffe import (
    Alias,
    Attribute,
    Class,
    DocstringAttribute,
    DocstringSection,
    DocstringSectionAttributes,
    DocstringSectionText,
    ExprCall,
    Extension,
    Function,
    Module,
    Object,
    Parameter,
    Parameters,
)
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).parent.parent
_FILES = ("*.md", "docs/*.md", "docs/*.css", "docs/pictures/*", "captures/README.md", "examples/*.ipynb")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Give the site the folders of the project, so that each link works in both. The README is the home page.

    mkdocs itself reads one folder, which must not contain mkdocs.yml.
    """
    of_theme = [file for file in files if file.src_dir != config.docs_dir]
    paths = [path.relative_to(_ROOT) for pattern in _FILES for path in sorted(_ROOT.glob(pattern))]
    ours = [File(path.as_posix(), str(_ROOT), config.site_dir, config.use_directory_urls) for path in paths]
    return Files([*of_theme, *ours])


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Show ``\\|`` in the code of a table as ``|``, as GitHub does: mkdocs needs no backslash there."""
    return re.sub(
        r"(?m)^\|.*$",
        lambda row: re.sub(r"`[^`]+`", lambda code: code[0].replace(r"\|", "|"), row[0]),
        markdown,
    )


class PublicNames(Extension):
    """Shows public names as users write them, and the attributes of each class as one table."""

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """Change the package after all its modules were read."""
        if pkg.path != "bcapscope":
            return
        for name, member in list(pkg.members.items()):
            target = pkg.members.get(str(member.value)) if isinstance(member, Attribute) else None
            if isinstance(target, Alias):  # Proxy = EmbeddedProxy
                pkg.set_member(name, Alias(name, target.target_path, parent=pkg))
        for each in _classes(pkg):
            _show_getters(each)
        tables = [(each, *_attribute_table(each)) for each in _classes(pkg)]
        for each, table, texts in tables:
            _show_table(each, table, texts)


def _classes(parent: Object) -> Iterator[Class]:
    for member in parent.members.values():
        if isinstance(member, Class):
            yield member
        if isinstance(member, Module):
            yield from _classes(member)


def _attribute_table(cls: Class) -> tuple[list[DocstringAttribute], list[DocstringSection]]:
    """Return the attributes of a class as rows, and the other sections of its docstring.

    A class describes an attribute in its own docstring, or in that of the attribute.
    """
    described = {
        name: text for each in (*reversed(cls.mro()), cls) for name, text in _described(each).items()
    }
    rows = []
    for name, member in {**cls.inherited_members, **cls.members}.items():
        if member.is_attribute and not name.startswith("_") and _is_plain(member):
            text = described.pop(name, None) or (member.docstring.value if member.docstring else "")
            rows.append(
                DocstringAttribute(name, description=text, annotation=_type_of(member), value=member.value)
            )
    rows += [DocstringAttribute(name, description=text) for name, text in described.items()]
    sections = cls.docstring.parsed if cls.docstring else []
    return rows, [each for each in sections if not isinstance(each, DocstringSectionAttributes)]


def _described(cls: Class) -> dict[str, str]:
    return {
        each.name: each.description
        for section in (cls.docstring.parsed if cls.docstring else ())
        if isinstance(section, DocstringSectionAttributes)
        for each in section.value
    }


def _type_of(member: Object | Alias) -> Any:
    """Return the annotation of an attribute, or of the parameter of ``__init__`` that it has as its value."""
    cls = (member.final_target if isinstance(member, Alias) else member).parent
    if member.annotation is not None or "__init__" not in cls.members:
        return member.annotation
    parameters = cls.members["__init__"].parameters
    return parameters[str(member.value)].annotation if str(member.value) in parameters else None


def _is_plain(member: Object | Alias) -> bool:
    """Return whether one text describes an attribute, without a section such as that of exceptions."""
    sections = member.docstring.parsed if member.docstring else []
    return all(isinstance(section, DocstringSectionText) for section in sections)


def _show_table(cls: Class, rows: list[DocstringAttribute], sections: list[DocstringSection]) -> None:
    for name in {row.name for row in rows} & cls.members.keys():
        cls.del_member(name)
    if not rows or cls.docstring is None:
        return
    if any("Enum" in str(base) for base in cls.bases):
        cells = [(f"`{row.name}`", f"`{row.value}`", " ".join(row.description.split())) for row in rows]
        lines = [("Name", "Value", "Meaning"), ("---",) * 3, *cells]
        used = 3 if any(row.description for row in rows) else 2
        table = "\n".join(f"| {' | '.join(line[:used])} |" for line in lines)
        cls.docstring.parsed = [*sections, DocstringSectionText(table)]
    else:
        shown = [row for row in rows if row.annotation is not None or row.description]
        cls.docstring.parsed = [*sections, DocstringSectionAttributes(shown)]


def _show_getters(cls: Class) -> None:
    """Show ``get_name = _getter(RemoteObject._invoke_text, ...)`` as a method that returns text."""
    for name, member in list(cls.members.items()):
        value = member.value if isinstance(member, Attribute) else None
        if isinstance(value, ExprCall) and str(value.function) == "_getter":
            invoked = cls.resolve("RemoteObject"), str(value.arguments[0]).rpartition(".")[2]
            returns = cls.modules_collection[".".join(invoked)].returns
            method = Function(name, parameters=Parameters(Parameter("self")), returns=returns, parent=cls)
            method.labels.add("async")
            cls.set_member(name, method)
