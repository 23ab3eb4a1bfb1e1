"""The page's parts, in NiceGUI.

What comes from nodes, bags and files is shown as text only, never as HTML or Markdown.
"""
