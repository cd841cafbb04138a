"""The page in a real browser without a GPU, on the real graph in lockstep: standing, walking, emergency stop, lost."""

import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain, graph_environment

pytest.importorskip("viser")
webdriver = pytest.importorskip("selenium.webdriver")

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
OPTIONS = ("--headless=new", "--no-sandbox", "--window-size=900,800")
DRAWN = {  #: Options by what draws the scene
    "software": ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "no WebGL": ("--disable-gpu", "--disable-3d-apis"),
}

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(
        None in (BROWSER, DRIVER), reason="no browser; Debian and Ubuntu: sudo apt install chromium chromium-driver"
    ),
]


NICENESS = 15
"""Of the browser: after everything else."""

DARK = 60
"""Grey of the G1's dark parts; neither grid nor page has any so dark in the scene [0..255]."""


class Visitor:
    """Somebody who looks at the page and presses its buttons."""

    def __init__(self, driver: Any, graph: Graph, pictures: Path) -> None:
        self.driver, self.graph, self._pictures = driver, graph, pictures

    @property
    def text(self) -> str:
        return str(self.driver.find_element("tag name", "body").text)

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = 90.0, up: bool = True) -> None:
        """Look until a condition holds; the launcher of a graph that is up goes on meanwhile."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, f"not {what}; the page says: {self.text}"
            (self.graph.spin if up else time.sleep)(0.2)

    def press(self, label: str) -> None:
        for button in self.driver.find_elements("tag name", "button"):
            if button.text.strip() == label:
                self.driver.execute_script("arguments[0].click()", button)
                return
        pytest.fail(f"no button '{label}'; the page says: {self.text}")

    def look(self, name: str) -> np.ndarray:
        """Take a picture; the left two thirds of it, where nothing but the scene is, grey (n, m) [0..255]."""
        data = self.driver.get_screenshot_as_png()
        (self._pictures / f"{name}.png").write_bytes(data)
        grey = np.asarray(Image.open(io.BytesIO(data)).convert("L"))
        return grey[grey.shape[0] // 5 :, : 2 * grey.shape[1] // 3]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def browser(drawn: str) -> Any:
    """Driver of a browser with the options of ``DRAWN``."""
    # It draws without a graphics card and would keep the graph from both cores.
    service = webdriver.ChromeService(DRIVER, popen_kw={"preexec_fn": lambda: os.nice(NICENESS)})
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in (*OPTIONS, *DRAWN[drawn]):
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=service)
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(120)
    return driver


@pytest.fixture(params=DRAWN)
def visitor(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Visitor]:
    domain, port = free_domain(), free_port()
    code = f"import sys; sys.argv[1:] = ['view', '--port', '{port}']; from bridge.cli import app; app()"
    with Graph("g1", domain_id=domain, lockstep=True, log=tmp_path / "log", say=lambda text: None) as graph:
        graph.wait_standing(180.0)
        printed = tmp_path / "printed"
        with printed.open("w") as file:
            environment = os.environ | graph_environment(domain_id=domain)
            page = subprocess.Popen([sys.executable, "-u", "-c", code], env=environment, stdout=file)
        driver = browser(request.param)
        try:
            end = time.monotonic() + 60.0
            while not (link := printed.read_text().partition(" shows ")[0]):
                assert page.poll() is None and time.monotonic() < end, "no page"
                graph.spin(0.2)
            driver.get(link)
            visitor = Visitor(driver, graph, tmp_path)
            visitor.wait(lambda: bool(driver.find_elements("id", "poise-drawing")), "drawn in two dimensions")
            if request.param == "software":
                driver.get(f"{link}&3d=1")
                assert not driver.find_elements("id", "poise-drawing")
            yield visitor
        finally:
            driver.quit()
            page.send_signal(signal.SIGINT)
            assert page.wait(30.0) == 0


def test_the_page_shows_and_steers_the_robot(visitor: Visitor) -> None:
    visitor.wait(lambda: "mode: stand" in visitor.text and "drivers: active" in visitor.text, "standing")
    visitor.wait(lambda: (visitor.look("stand") < DARK).mean() > 0.001, "a robot in the picture")
    visitor.press("walk")
    visitor.wait(lambda: "mode: walk" in visitor.text, "walking")
    visitor.graph.send("forward")
    visitor.wait(lambda: "gait: single" in visitor.text and "in command: plain" in visitor.text, "making steps")
    visitor.look("walk")
    visitor.press("E-STOP")
    visitor.wait(lambda: "mode: damp" in visitor.text and "emergency stop" in visitor.text.lower(), "stopped")
    visitor.look("fault")
    visitor.wait(lambda: visitor.graph.mode == "damp", "damped")  # page and launcher receive the mode independently
    visitor.graph.stop()
    visitor.wait(lambda: "waiting for data on" in visitor.text and "no data for" in visitor.text, "lost", up=False)
    visitor.wait(lambda: "next: poise up" in visitor.text, "lost by all nodes", up=False)  # diagnostics may end later
    visitor.look("lost")


def test_a_page_that_lost_its_server_says_why() -> None:
    from bridge.view.server import serve

    port, driver = free_port(), browser("no WebGL")
    server, link = serve("127.0.0.1", port, "g1")

    def wait(text: str) -> None:
        end = time.monotonic() + 60.0
        while text not in (said := driver.find_element("tag name", "body").text):
            assert time.monotonic() < end, said
            time.sleep(0.2)

    try:
        driver.get(link)
        wait("poise: g1")
        server.stop()
        wait("No connection to 'poise view'")
        server, _ = serve("127.0.0.1", port, "g1")
        wait("wrong token; open the newest link that 'poise view' printed")
    finally:
        driver.quit()
        server.stop()
