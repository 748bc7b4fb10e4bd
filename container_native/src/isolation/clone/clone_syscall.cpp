// The system calls clone3 and clone with a new process that goes on on its parent's stack. They
// cannot be made through a function that returns: the child would return into its parent's frames.

#include "isolation/clone/clone_syscall.hpp"

// The child begins below the return address that the parent will need when it goes on. Its frames
// have no caller: debuggers and the search for an exception's handler end there.
#if defined(__x86_64__)
asm(R"(
    .text
    .p2align 4
    .hidden play_launch_clone_syscall
    .globl play_launch_clone_syscall
    .type play_launch_clone_syscall, @function
play_launch_clone_syscall:
    .cfi_startproc
    endbr64
    mov %rdi, %rax
    mov %rsi, %rdi
    mov %rdx, %rsi
    mov %rcx, %rdx
    syscall
    test %rax, %rax
    jz 1f
    ret
    .cfi_endproc
1:
    .cfi_startproc
    .cfi_undefined rip
    xor %ebp, %ebp
    and $-16, %rsp
    mov %r9, %rdi
    call *%r8
    mov %eax, %edi
    mov $231, %eax # exit_group
    syscall
    hlt
    .cfi_endproc
    .size play_launch_clone_syscall, . - play_launch_clone_syscall
)");
#elif defined(__aarch64__)
asm(R"(
    .text
    .p2align 4
    .hidden play_launch_clone_syscall
    .globl play_launch_clone_syscall
    .type play_launch_clone_syscall, %function
play_launch_clone_syscall:
    .cfi_startproc
    hint #34 // bti c
    mov x8, x0
    mov x0, x1
    mov x1, x2
    mov x2, x3
    svc #0
    cbz x0, 1f
    ret
    .cfi_endproc
1:
    .cfi_startproc
    .cfi_undefined x30
    mov x29, #0
    mov x30, #0
    mov x0, x5
    blr x4
    mov x8, #94 // exit_group
    svc #0
    brk #1
    .cfi_endproc
    .size play_launch_clone_syscall, . - play_launch_clone_syscall
)");
#else
#error "isolation in a shared address space is written for x86-64 and aarch64"
#endif
