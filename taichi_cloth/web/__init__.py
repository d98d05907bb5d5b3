"""A running scene in web pages: a server, what it tells, what pages may say, and the page itself."""
