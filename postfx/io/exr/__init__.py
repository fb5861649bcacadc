"""OpenEXR files as what they are made of: headers of attributes, and chunks of pixels that need not be decoded."""
