"""The interactive viewer: window, control panel, mouse and keyboard input, screenshots, clips and replay."""
