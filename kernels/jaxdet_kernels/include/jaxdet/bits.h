// Bitmap with one bit per cell; rows are padded to a power of two of 32-bit words.
#pragma once
#include "vectors.h"

namespace jaxdet { namespace {

struct BitRows {
    enum { WIDTH = 32 };
    // Number of rows; number of words per row that hold cells; binary logarithm of the row length in
    // words, with padding. Bits after the last cell of a row are 0.
    int rows, words, shift;
    unsigned* bits;

    BitRows(int rows, int columns, int* place)
        : rows(rows), words((columns + WIDTH - 1) / WIDTH), shift(0), bits((unsigned*)place) {
        while (1 << shift < words) ++shift;
    }

    int count() const { return rows << shift; }
    unsigned& operator[](int i) const { return bits[i]; }
    // `at` is the index of word w of row r; `row` is the row of word i; `column` is the column of the
    // first cell of word i.
    int at(int r, int w) const { return r << shift | w; }
    int row(int i) const { return i >> shift; }
    int column(int i) const { return (i & ((1 << shift) - 1)) * WIDTH; }

    // Words whose bit k is the bit of one neighbour of cell k of word i: of the previous or the next cell
    // in the row, or of the cell above or below. Cells outside the grid have bit 0.
    unsigned before(int i) const {
        return bits[i] << 1 | (column(i) ? bits[i - 1] >> (WIDTH - 1) : 0);
    }
    unsigned after(int i) const {
        return bits[i] >> 1 | (column(i + 1) ? bits[i + 1] << (WIDTH - 1) : 0);
    }
    unsigned above(int i) const { return row(i) ? bits[i - (1 << shift)] : 0; }
    unsigned below(int i) const { return row(i) + 1 < rows ? bits[i + (1 << shift)] : 0; }

    // `popcount` is the number of set bits; `lowest` is the index of the lowest set bit.
    static int popcount(unsigned word) {
#if defined(__CUDA_ARCH__)
        return __popc(word);
#else
        return __builtin_popcount(word);
#endif
    }
    static int lowest(unsigned word) {
#if defined(__CUDA_ARCH__)
        return __ffs(word) - 1;
#else
        return __builtin_ctz(word);
#endif
    }

    // Packs bit `shift` of each of n bytes into a word; n is at most WIDTH.
    static unsigned packed(const unsigned char* bytes, int shift, int n) {
#if defined(__clang__) && !defined(__CUDA_ARCH__)
        if (n >= WIDTH) return packed(*(const Vectors::Bytes*)bytes >> (unsigned char)shift & 1);
#endif
        unsigned word = 0;
        for (int k = 0; k < n && k < WIDTH; ++k) word |= (unsigned)(bytes[k] >> shift & 1) << k;
        return word;
    }

    // Sets bit k of a word if label k of n labels is at least 0; n is at most WIDTH.
    static unsigned labelled(const int* labels, int n) {
#if defined(__clang__) && !defined(__CUDA_ARCH__)
        if (n >= WIDTH) return packed(*(const Vectors::Wide*)labels >= 0);
#endif
        unsigned word = 0;
        for (int k = 0; k < n && k < WIDTH; ++k) word |= (unsigned)(labels[k] >= 0) << k;
        return word;
    }

#if defined(__clang__) && !defined(__CUDA_ARCH__)
    // Sets bit k of a word if element k of a vector of WIDTH elements is not 0; this takes one
    // instruction per register.
    template <class Elements> static unsigned packed(Elements elements) {
        typedef bool Flags __attribute__((ext_vector_type(WIDTH)));
        return __builtin_bit_cast(unsigned, __builtin_convertvector(elements, Flags));
    }
#endif

    // Writes the transpose to `out`: its bit at row c and column r is this bitmap's bit at row r and
    // column c.
    void transpose(const Team& team, const BitRows& out) const {
        for (int block = team.rank; block < words * out.words; block += team.size) {
            const int w = block % words, top = block / words * WIDTH;
            unsigned a[WIDTH];
            for (int k = 0; k < WIDTH; ++k) a[k] = top + k < rows ? bits[at(top + k, w)] : 0;
            // Hacker's Delight, 2nd edition, 7-3, with the lowest bit first.
            unsigned mask = 0x0000ffff;
            for (int half = WIDTH / 2; half; half >>= 1, mask ^= mask << half)
                for (int k = 0; k < WIDTH; k = (k + half + 1) & ~half) {
                    const unsigned swapped = (a[k] >> half ^ a[k + half]) & mask;
                    a[k] ^= swapped << half;
                    a[k + half] ^= swapped;
                }
            for (int k = 0; k < WIDTH && w * WIDTH + k < out.rows; ++k)
                out.bits[out.at(w * WIDTH + k, top / WIDTH)] = a[k];
        }
    }

    // Clears the padding words, which hold no cells.
    void clear_padding(const Team& team) const {
        for (int i = team.rank; i < count(); i += team.size)
            if (column(i) >= words * WIDTH) bits[i] = 0;
    }
};

} }  // namespace jaxdet
