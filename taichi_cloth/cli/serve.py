"""The command `web`: an interactive browser view of a scene that runs on this machine."""

from __future__ import annotations

import argparse
import importlib.util
import secrets
import socket
import sys
from contextlib import closing

from ..system import taichi_runtime as runtime
from ..system.errors import UsageError
from .options import Command, chosen_scene, scene_options, summary

PORT = 8080
IFRAME_SIZE = 960, 540  # [pixels] size of the <iframe>
MIN_TOKEN = 8  # [characters]


def add_commands(command: Command) -> None:
    """Add the command `web`."""
    web = command("web", run_web, "serve an interactive browser view of a scene", "web curtain")
    scene_options(web, nargs="?")
    web.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen on; all but loopback addresses need a token",
    )
    web.add_argument("--port", type=port, default=PORT, metavar="N", help="port to listen on; 0 picks a free port")
    web.add_argument(
        "--token",
        type=token,
        metavar="WORD",
        help="access token (default: none on a loopback address, else a random one, which is printed)",
    )
    web.add_argument(
        "--print-iframe", action="store_true", help="also print an <iframe> element for use in another page"
    )


def port(text: str) -> int:
    """Parse a port, 0 to 65535."""
    if not text.isdecimal() or not int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def token(text: str) -> str:
    """Parse a token: printable characters, too many to be guessed within a minute."""
    if len(text) < MIN_TOKEN or not text.isprintable():
        raise argparse.ArgumentTypeError(f"a token needs {MIN_TOKEN} or more printable characters")
    return text


def run_web(args: argparse.Namespace) -> int:
    """Run the command `web` until it is interrupted."""
    scene = chosen_scene(args)
    if importlib.util.find_spec("websockets") is None:
        raise UsageError("the browser view needs websockets: pip install 'taichi-cloth[web]'")
    from ..render.webgl import fill_template
    from ..system.console import spinner
    from ..web.server import PAGE_FILE, AccessControl, WebServer, is_loopback

    loopback = is_loopback(args.host)
    access_token = args.token or ("" if loopback else secrets.token_urlsafe(16))
    access = AccessControl(access_token, only_loopback=loopback)
    with closing(
        WebServer(args.host, args.port, access, fill_template(PAGE_FILE, scene.title or scene.name, {}).encode())
    ) as server:
        arch = runtime.start(args.arch)
        from ..viewer.session import Session
        from ..web.app import WebApp

        with spinner(f"{scene.name}: compiling kernels (some seconds on the first run)"):
            session = Session(scene, args.layout)
        with closing(session):
            print(summary(session.simulation, arch), flush=True)
            name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(args.host, args.host)
            address = f"http://{f'[{name}]' if ':' in name else name}:{server.port}/{access.query}"
            if not loopback:
                print(f"taichi-cloth: anyone with this address can control the scene: {address}", file=sys.stderr)
            print(f"open {address} in a browser; Ctrl-C stops the server", flush=True)
            if args.print_iframe:
                print(iframe(address), flush=True)
            try:
                WebApp(session, server).run()
            except KeyboardInterrupt:
                print("stopped", flush=True)
    return 0


def iframe(address: str) -> str:
    """Return an `<iframe>` of the cloth alone, without the panel, for another page."""
    width, height = IFRAME_SIZE
    plain = address + ("&" if "?" in address else "?") + "plain"
    return f'<iframe src="{plain.replace("&", "&amp;")}" width="{width}" height="{height}" style="border:0"></iframe>'
