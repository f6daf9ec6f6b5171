"""Shows the difference between two plans, benches or runs as a page, and as a comment in Markdown for a review.

On the page and in the comment, texts from files are treated as data. On the page, they are escaped, and the content security policy
does not permit any loading or execution. In the comment, every text from a file is in a code element, and all characters that
Markdown could interpret are written as entities.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from planrunner.base.documents import JsonObject
from planrunner.base.findings import count_of
from planrunner.plan.schedule import Schedule
from planrunner.reporting.difference_tables import difference_tables, headline, notes
from planrunner.reporting.orientations import orientation_svg
from planrunner.reporting.printable import printable
from planrunner.reporting.show_page import MAX_BARS, MAX_PICTURES, labels_in_short, totals
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, table_view
from planrunner.review.compared import Compared
from planrunner.review.difference import PartChange

MOST_CHARACTERS = 60_000
"""Maximum length of a comment. Code hosts refuse comments of more than 65 536 characters."""

_SIDES = ("before", "after")


def render_difference(compared: Compared) -> str:
    """Renders one self-contained HTML page. The same difference gives the same text. Raises `ReportError` if the page cannot be
    rendered."""
    return render("difference.html", difference_view(compared))


def difference_view(compared: Compared) -> JsonObject:
    """Returns the data for the template: headline, sides (name, digest, totals, timeline), tables, pictures, notes."""
    pictures = list(_pictures(compared))
    hidden = len(pictures) - MAX_PICTURES
    return {
        "kind": compared.kind,
        "title": _title(compared),
        "headline": headline(compared),
        "different": compared.different,
        "sides": [
            {
                "name": name,
                "side": side,
                "title": title,
                "facts": named({"SHA-256 of the meaning": digest, **({} if schedule is None else totals(schedule))}),
                "timeline": _timeline(schedule, side),
            }
            for name, side, title, digest, schedule in zip(
                compared.names, _SIDES, compared.titles, compared.digests, compared.schedules, strict=True
            )
        ],
        "tables": [table_view(table) for table in difference_tables(compared)],
        "pictures": pictures[:MAX_PICTURES],
        "more_pictures": f"Not shown here: {count_of(hidden, 'more orientation')}." if hidden > 0 else "",
        "notes": notes(compared),
    }


def _title(compared: Compared) -> str:
    what = {"plan": "plans", "bench": "benches", "run": "runs"}[compared.kind]
    titles = [title for title in dict.fromkeys(compared.titles) if title]
    return titles[0] if len(titles) == 1 else f"Difference of two {what}"


def _timeline(schedule: Schedule | None, side: str) -> str:
    from markupsafe import Markup

    from planrunner.reporting.plots import timeline_svg

    if schedule is None or not 0 < len(schedule.segments) <= MAX_BARS:
        return ""
    return Markup(timeline_svg(schedule, f"timeline-{side}"))


def _pictures(compared: Compared) -> Iterator[JsonObject]:
    """Yields one picture for each changed orientation. Segments whose orientation changes in the same way share one picture."""
    from markupsafe import Markup

    groups: dict[str, tuple[PartChange, list[str]]] = {}
    for item in compared.meaning.segments:
        for change in item.changes:
            if change.place == ("orientation",):
                groups.setdefault(repr((change.before, change.after)), (change, []))[1].append(
                    item.after or item.before or ""
                )
    for change, labels in groups.values():
        shown = [
            {"svg": Markup(orientation_svg(_attitude(content), side)), "words": words, "side": side}
            for content, words, side in zip((change.before, change.after), change.shown, _SIDES, strict=True)
            if content is not None
        ]
        what = "added" if change.before is None else "removed" if change.after is None else "changed"
        yield {"labels": labels_in_short(labels), "what": what, "sides": shown}


def _attitude(content: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None:
    return np.array(content, dtype=float) if isinstance(content, list) else None


# -- Markdown --------------------------------------------------------------------------------------------------------


def difference_markdown(compared: Compared) -> str:
    """Returns the difference as a comment in Markdown. Tables that would make the comment too long are omitted, and the comment
    states this."""
    first, second = (code(name) for name in compared.names)
    lines = [f"**{headline(compared)}**", "", f"{first} → {second}", ""]
    size = sum(len(line) + 1 for line in lines)
    left_out = []
    for table in difference_tables(compared):
        view = table_view(table)
        rows = [[code(cell) for cell in row] for row in view["rows"]]
        text = [f"#### {table.title}", "", *_table([column["title"] for column in view["columns"]], rows)]
        text += [*([view["more"]] if view["more"] else []), ""]
        length = sum(len(line) + 1 for line in text)
        if size + length > MOST_CHARACTERS:
            left_out.append(table.title)
            continue
        lines += text
        size += length
    if left_out:
        lines.append(f"Too long for a comment: {', '.join(left_out)}.")
    lines += [f"- {code(line)}" for line in notes(compared)]
    digests = " → ".join(code(digest[:16]) for digest in compared.digests)
    lines += ["", f"SHA-256 of the meaning: {digests}"]
    return "\n".join(lines).rstrip() + "\n"


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(titles)} |"
    yield f"|{'|'.join(' --- ' for _ in titles)}|"
    for row in rows:
        yield f"| {' | '.join(row)} |"


_PLAIN = frozenset(" ,+-=()%°±→–−")


def code(text: str) -> str:
    """Returns a text as a code element in Markdown. No part of the text then acts as markup, as a link, as a mention or as the end
    of a table cell."""
    one_line = printable(" ".join(text.split()), keep="")
    dots = "" if "www." in one_line.lower() else "."
    signs = [char if char.isalnum() or char in _PLAIN or char in dots else f"&#{ord(char)};" for char in one_line]
    return f"<code>{''.join(signs)}</code>" if one_line else ""
