"""The viewer: a page that relights files in a browser, served from this machine or written as one file."""
