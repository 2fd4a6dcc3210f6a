"""Renderers for text, trees, hex dumps, tables, JSON, CSV and HTML.

They return strings or bytes and print nothing.
"""
