"""The panel on a screen: a page that draws a time code, one number a refresh, and a server for it.

The page is one file without any resource of the network: `page.html` with its style and scripts put in.
"""
