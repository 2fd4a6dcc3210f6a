"""Renderers for text, trees, hex dumps, tables, JSON, CSV and HTML.

The renderers return strings or bytes; they do not print them.
"""
