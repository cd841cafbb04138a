"""The page of ``poise view``: a robot in a browser, and buttons for what its topics and services offer."""
