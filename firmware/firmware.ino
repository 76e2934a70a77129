// For the Arduino IDE only: open this folder as a sketch, choose "Arduino Uno", upload.
// The C files beside it are the whole program, with a main() of their own.
