"""Hostile text, and what a browser would make of a page."""

from __future__ import annotations

from html.parser import HTMLParser

HOSTILE = """<script>alert("1")</script><b a='>"""


class Tags(HTMLParser):
    """The tags of a page, and the texts between them."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.texts = set(), []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)

    def handle_data(self, text):
        self.texts.append(text)
