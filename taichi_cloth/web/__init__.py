"""The browser view of a running scene: a WebSocket server, its protocol, and the page."""
