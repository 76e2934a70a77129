"""A page in a real browser: errors on its console, elements too wide, texts too faint."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

DESKTOP, PHONE = (1280, 900), (390, 844)
PATIENCE = 60.0
# WCAG 2.1 AA for text of this size
LEAST_CONTRAST = 4.5

_WIDER = """() => [...document.querySelectorAll('body *')]
  .filter((e) => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .filter((e) => !e.parentElement.closest('table, .scroll, .wide'))
  .map((e) => `${e.tagName} ${e.id} ${e.className} ${e.textContent.slice(0, 40)}`)
  .concat(document.documentElement.scrollWidth > window.innerWidth ? ['the page itself'] : [])"""

_FAINT = Path(__file__).with_name("faint_texts.js").read_text()


@dataclass
class Opened:
    """A page, and the errors on its console."""

    page: Any
    complaints: list[str] = field(default_factory=list)

    def until(self, condition, patience=PATIENCE):
        """Wait for a JavaScript condition by polling; a page's policy may forbid other ways."""
        end = time.monotonic() + patience
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, f"not within {patience} s: {condition}"
            self.page.wait_for_timeout(50)

    def text(self, selector):
        """Visible text of the first such element."""
        return self.page.evaluate(f"document.querySelector({selector!r}).innerText")

    @property
    def too_wide(self):
        """Elements that make the page scroll sideways; tables may scroll on their own."""
        return self.page.evaluate(_WIDER)

    @property
    def faint(self):
        """Texts with too little contrast to their background."""
        return self.page.evaluate(_FAINT, LEAST_CONTRAST)


@contextmanager
def opened(browser, url, size=DESKTOP, scheme="light", **options):
    """A page at `url` in a window of `size`, light or dark."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, **options
    )
    try:
        found = Opened(context.new_page())
        context.set_default_timeout(1e3 * PATIENCE)
        found.page.on("pageerror", lambda error: found.complaints.append(str(error)))
        found.page.on(
            "console", lambda said: said.type == "error" and found.complaints.append(said.text)
        )
        found.page.goto(url)
        yield found
    finally:
        context.close()
