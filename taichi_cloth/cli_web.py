"""The command `web`: a scene that runs here, to look at and to pull at in browsers."""

from __future__ import annotations

import argparse
import importlib.util
import secrets
import socket
import sys
from contextlib import closing

from . import runtime
from .cli_options import Command, chosen_scene, scene_options, summary
from .errors import WrongUse

PORT = 8080
EMBEDDED = 960, 540  # [pixels]
LEAST_TOKEN = 8  # letters


def declare(command: Command) -> None:
    web = command("web", run_web, "serve a scene to browsers, where it is looked at and pulled at", "web curtain")
    scene_options(web, nargs="?")
    web.add_argument(
        "--host", default="127.0.0.1", metavar="NAME", help="where to listen; any but this machine's own needs a token"
    )
    web.add_argument("--port", type=port, default=PORT, metavar="N", help="port to listen at; 0 takes any that is free")
    web.add_argument(
        "--token",
        type=token,
        metavar="WORD",
        help="what an address must end with (default: none, or one that is made and printed)",
    )
    web.add_argument(
        "--embed", action="store_true", help="also print a line of HTML that shows the cloth in another page"
    )


def port(text: str) -> int:
    """From 0 to 65535."""
    if not text.isdecimal() or not int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def token(text: str) -> str:
    """Long enough not to be guessed in a minute."""
    if len(text) < LEAST_TOKEN or not text.isprintable():
        raise argparse.ArgumentTypeError(f"a token has {LEAST_TOKEN} letters or more")
    return text


def run_web(args: argparse.Namespace) -> int:
    scene = chosen_scene(args)
    if importlib.util.find_spec("websockets") is None:
        raise WrongUse("pages in a browser need websockets: pip install 'taichi-cloth[web]'")
    from .page.template import filled
    from .progress import waiting
    from .web.doors import DOCUMENT, Doors, is_loopback
    from .web.hub import Hub

    own = is_loopback(args.host)
    word = args.token or ("" if own else secrets.token_urlsafe(16))
    doors = Doors(word, only_loopback=own)
    with closing(Hub(args.host, args.port, doors, filled(DOCUMENT, scene.title or scene.name, {}).encode())) as hub:
        arch = runtime.start(args.arch)
        from .view.session import Session
        from .web.serving import Serving

        with waiting(f"{scene.name}: compiling, which takes some seconds the first time"):
            session = Session(scene, args.path)
        with closing(session):
            print(summary(session.simulation, arch), flush=True)
            name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(args.host, args.host)
            address = f"http://{f'[{name}]' if ':' in name else name}:{hub.port}/{doors.tail}"
            if not own:
                print(f"taichi-cloth: anybody who knows this address can steer the cloth: {address}", file=sys.stderr)
            print(f"open {address} in a browser; Ctrl-C ends", flush=True)
            if args.embed:
                print(embedding(address), flush=True)
            try:
                Serving(session, hub).run()
            except KeyboardInterrupt:
                print("ended", flush=True)
    return 0


def embedding(address: str) -> str:
    """A line that shows the cloth alone, without the panel, inside another page."""
    width, height = EMBEDDED
    plain = address + ("&" if "?" in address else "?") + "plain"
    return f'<iframe src="{plain.replace("&", "&amp;")}" width="{width}" height="{height}" style="border:0"></iframe>'
