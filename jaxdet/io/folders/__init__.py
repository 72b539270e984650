"""Folders of colour and depth images: layouts, and the messages made of their contents.

::

    layouts                         list of all layouts; recognizes folders and reads them
      basic, datasets, phones         one function per layout, folder -> recording
        text, recording                 text files; the form that all layouts are read into
    messages                        recording -> messages
"""
