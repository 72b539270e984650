"""Folders of colour and depth images.

::

    layouts                         list of all layouts; recognizes folders and reads them
      basic, phones                   one function per layout, folder -> recording
        recording                       common form of all layouts; parsing of text files
"""
