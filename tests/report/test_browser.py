"""The page in a real browser: it draws, zooms by mouse and by keys, and fits wide and narrow."""

import re

import pytest


@pytest.fixture
def visit(browser, report):
    """Opens the report; whatever goes wrong or is loaded on the way fails the test."""
    wrong, contexts = [], []

    def visit(width=1280, scheme="light", **options):
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=scheme, **options
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: wrong.append(request.url))
        page.goto(report.path.as_uri())
        assert wrong.pop(0) == report.path.as_uri()
        return page

    yield visit
    for context in contexts:
        context.close()
    assert wrong == []


def x_ticks(holder):
    """The range that the x axis' labels tell."""
    found = holder.evaluate(
        """node => [...node.querySelectorAll("text.middle")].map(e => e.textContent)"""
    )
    values = [float(text.replace("−", "-")) for text in found]
    return min(values), max(values)


def plot(page, name):
    return page.locator(f"[data-figure='{name}']")


def frame(holder):
    """The figure's element around its drawing: caption, readout and button."""
    return holder.locator("xpath=..")


def drag(page, holder, start, end):
    holder.scroll_into_view_if_needed()
    box = holder.bounding_box()
    y = box["y"] + 0.5 * box["height"]
    page.mouse.move(box["x"] + start * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * (start + end) * box["width"], y)
    page.mouse.move(box["x"] + end * box["width"], y)
    page.mouse.up()


@pytest.mark.slow
def test_every_figure_is_drawn(visit):
    page = visit()
    holders = page.locator("[data-figure]")
    assert holders.count() >= 20
    drawn = holders.evaluate_all(
        """nodes => nodes.map(node => [
          node.querySelector("svg > title").textContent,
          [...node.querySelectorAll(
            node.dataset.figure === "timeline" ? "rect.span" : "path.line"
          )].map(shape => shape.getAttribute("d") || shape.getAttribute("width")),
        ])"""
    )
    for title, shapes in drawn:
        assert title
        assert shapes
        assert all(shape and "NaN" not in shape for shape in shapes)


@pytest.mark.slow
def test_mouse_zooms_a_group_and_double_click_shows_all_again(visit):
    page = visit()
    roll, yaw, rate = (plot(page, n) for n in ("prediction-roll", "prediction-yaw", "rate-roll"))
    before, others = x_ticks(roll), x_ticks(rate)
    drag(page, roll, 0.4, 0.6)
    low, high = x_ticks(roll)
    assert before[0] < low < high < before[1]
    assert x_ticks(yaw) == (low, high)  # the group goes along,
    assert x_ticks(rate) == others  # others do not
    button = frame(roll).get_by_role("button", name="Reset zoom")
    assert button.is_visible()
    roll.dblclick()
    assert x_ticks(roll) == x_ticks(yaw) == before
    assert not button.is_visible()


@pytest.mark.slow
def test_keys_do_all_that_the_mouse_does(visit):
    page = visit()
    figure = plot(page, "rate-pitch")
    figure.focus()
    before = x_ticks(figure)
    for _ in range(3):
        page.keyboard.press("+")
    low, high = x_ticks(figure)
    assert before[0] < low < high < before[1]
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert x_ticks(figure) > (low, high)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert x_ticks(figure) == (low, high)
    for _ in range(2):
        page.keyboard.press("-")
    wider = x_ticks(figure)
    assert wider[1] - wider[0] > high - low
    page.keyboard.press("0")
    assert x_ticks(figure) == before
    # Zooming further than there are data ends somewhere.
    for _ in range(60):
        page.keyboard.press("+")
    x_ticks(figure)
    page.keyboard.press("Escape")
    assert x_ticks(figure) == before


@pytest.mark.slow
def test_pointing_tells_the_numbers(visit):
    page = visit()
    roll = plot(page, "prediction-roll")
    roll.scroll_into_view_if_needed()
    roll.hover()
    told = frame(roll).locator("output").text_content()
    assert re.fullmatch(r"[\d.]+ s · measured −?[\d.]+.* · predicted −?[\d.]+.*", told)
    page.mouse.move(0, 0)
    assert frame(roll).locator("output").text_content() == ""


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1600])
def test_fits_wide_and_narrow(visit, width):
    page = visit(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = page.evaluate(
        """[...document.querySelectorAll("[data-figure]")].map(e => {
          const box = e.getBoundingClientRect();
          return [box.left, box.right];
        })"""
    )
    for left, right in boxes:
        assert 0 <= left <= right - 250 <= width - 250


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast(visit, scheme):
    """4.5 to 1 at least, as WCAG AA asks, of every text on what lies behind it."""
    page = visit(1280, scheme)
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    dark = sum(map(int, re.findall(r"\d+", ground)[:3])) < 200
    assert dark is (scheme == "dark")
    worst = page.evaluate(
        """() => {
          const parse = (c) => c.match(/[\\d.]+/g).map(Number);
          const light = ([r, g, b]) => {
            const [x, y, z] = [r, g, b].map((v) => {
              v /= 255;
              return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
            });
            return 0.2126 * x + 0.7152 * y + 0.0722 * z;
          };
          const behind = (e) => {
            for (; e; e = e.parentElement) {
              const c = parse(getComputedStyle(e).backgroundColor);
              if (c.length < 4 || c[3] === 1) return c;
            }
            return [255, 255, 255];
          };
          let worst = [99, ""];
          const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
          while (walk.nextNode()) {
            const e = walk.currentNode.parentElement;
            const text = walk.currentNode.data.trim();
            if (!text || e.closest("script, style, title, noscript, .mark, .sign")) continue;
            const style = getComputedStyle(e);
            const ink = parse(e.ownerSVGElement ? style.fill : style.color);
            const [a, b] = [light(ink), light(behind(e))].sort((p, q) => q - p);
            const ratio = (a + 0.05) / (b + 0.05);
            if (ratio < worst[0]) worst = [ratio, text];
          }
          return worst;
        }"""
    )
    assert worst[0] >= 4.5, worst


@pytest.mark.slow
def test_touch_zooms_too(visit):
    page = visit(390, has_touch=True, is_mobile=True)
    roll = plot(page, "prediction-roll")
    roll.scroll_into_view_if_needed()
    before = x_ticks(roll)
    box = roll.bounding_box()
    y = box["y"] + 60
    session = page.context.new_cdp_session(page)
    for kind, share in (("touchStart", 0.3), ("touchMove", 0.5), ("touchMove", 0.7)):
        at = {"x": box["x"] + share * box["width"], "y": y}
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [at]})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    after = x_ticks(roll)
    assert before[0] <= after[0] < after[1] <= before[1]
    assert after != before


@pytest.mark.slow
def test_prints_on_white_without_what_is_only_for_screens(visit):
    page = visit(1280, "dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert not page.locator("nav").is_visible()
    assert page.locator("[data-figure='prediction-roll'] svg").is_visible()
    assert len(page.pdf(format="A4")) > 10_000
